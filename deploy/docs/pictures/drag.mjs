/**
 * Records deploy/docs/pictures/drag.webp, the moving picture of README.md, with a built pliant and a headless Chromium.
 *
 * usage: node deploy/docs/pictures/drag.mjs PLIANT OUT.webp
 *
 * Needs `npm ci --prefix tests/clients/viewer`, Chromium (CHROMIUM names another one), and a Python with Pillow (PYTHON names
 * it; default: python3). FRAMES names a folder that keeps the single frames.
 */

import { execFileSync } from "node:child_process";
import { mkdirSync, mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const [pliant, out] = process.argv.slice(2);
if (out === undefined) {
  console.error("usage: node deploy/docs/pictures/drag.mjs PLIANT OUT.webp");
  process.exit(2);
}
// The server's module reads this when it is loaded.
process.env.PLIANT_BIN = resolve(pliant);
const viewerTest = new URL("../../../tests/clients/viewer/", import.meta.url);
const { Server } = await import(new URL("server.mjs", viewerTest));
const { BROWSER, Sheet, launch } = await import(new URL("browser.mjs", viewerTest));
const { openSample } = await import(new URL("scenes/sample.mjs", viewerTest));

const FRAMES_PER_SECOND = 11;
const MOST_BYTES = 700_000;
const PAGE = { width: 960, height: 590 };
/** Leaves out the status bar: its shapes per second are wrong here, because every step waits for a screenshot. */
const CLIP = { x: 0, y: 0, width: 960, height: 564 };
/** Turns of the wheel that bring the creature nearer. */
const NEARER = -300;
/** Pointer steps before, in and after the drag. */
const STEPS = { approach: 7, drag: 40, leave: 6 };
/** The shape is complete when no new one is painted for this long. */
const QUIET_MS = 150;
/** A step that changes no shape is not waited for longer than this. */
const UNCHANGED_MS = 1500;

/** Draws a pointer on the page, because a headless browser shows none. A disc is behind it while the button is down. */
function drawPointer() {
  const pointer = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  pointer.setAttribute("viewBox", "-14 -14 42 42");
  const size = { width: "42px", height: "42px" };
  Object.assign(pointer.style, { ...size, position: "fixed", left: "0", top: "0", pointerEvents: "none", zIndex: "9999" });
  pointer.innerHTML =
    '<circle r="11" fill="#ffc14d" fill-opacity="0.35" stroke="#ffc14d" stroke-width="2"/>' +
    '<path d="M0 0V20L5 15.5L8.5 23L12 21.5L8.7 14H15.5Z" fill="#fff" stroke="#101418" stroke-width="1.4"/>';
  document.body.append(pointer);
  const [press] = pointer.children;
  const follow = ({ clientX, clientY, buttons }) => {
    pointer.style.transform = `translate(${clientX - 14}px, ${clientY - 14}px)`;
    press.style.visibility = buttons === 0 ? "hidden" : "visible";
  };
  for (const kind of ["pointermove", "pointerdown", "pointerup"]) addEventListener(kind, follow, true);
}

/** Slow at both ends, as a hand moves. */
const eased = (t) => t * t * (3 - 2 * t);

/** Where the pointer is at a share of the drag, from where it took the gizmo: up, around a bend, and back to the start. */
function dragPath(share) {
  const angle = Math.PI * eased(share);
  return { x: 80 * Math.sin(2 * angle), y: -115 * Math.sin(angle) };
}

const pause = (ms) => new Promise((done) => setTimeout(done, ms));

/** Waits until the shape of the last pointer step is painted. */
async function shapeIsPainted(sheet, before) {
  const begun = performance.now();
  let [seen, since] = [before, begun];
  for (;;) {
    const { painted } = await sheet.ask("state");
    const now = performance.now();
    if (painted !== seen) [seen, since] = [painted, now];
    if (now - since > (seen === before ? UNCHANGED_MS : QUIET_MS)) break;
    await pause(20);
  }
  await sheet.page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
}

async function record(sheet, folder) {
  const { page } = sheet;
  const { mouse } = page;
  let count = 0;
  const shoot = () => page.screenshot({ path: join(folder, `${String(count++).padStart(3, "0")}.png`), clip: CLIP });

  await openSample(sheet);
  await sheet.key("g");
  await page.getByRole("button", { name: "Head", exact: false }).first().click();
  // The wheel zooms to the pointer: the head stays where it is and the feet move down, which leaves room above the head.
  const { left, right, top } = await sheet.outline();
  const { eye } = await sheet.ask("camera");
  await mouse.move((left + right) / 2, top);
  await mouse.wheel(0, NEARER);
  await page.waitForFunction((was) => String(window.pliantViewer.camera().eye) !== was, String(eye));
  const start = (await sheet.ask("handles")).find(({ name }) => name === "Head").at;
  await page.evaluate(drawPointer);
  const away = { x: start.x + 110, y: start.y + 120 };

  for (let k = 0; k <= STEPS.approach; k++) {
    const left = 1 - eased(k / STEPS.approach);
    await mouse.move(start.x + (away.x - start.x) * left, start.y + (away.y - start.y) * left);
    await pause(60);
    await shoot();
  }
  const { gizmoPart, revision } = await sheet.ask("state");
  if (gizmoPart !== "XYZ") throw new Error(`the pointer is over the gizmo's part ${gizmoPart}, not over its centre`);
  await mouse.down();
  await pause(60);
  await shoot();
  for (let k = 1; k <= STEPS.drag; k++) {
    const { painted } = await sheet.ask("state");
    const { x, y } = dragPath(k / STEPS.drag);
    await mouse.move(start.x + x, start.y + y);
    await shapeIsPainted(sheet, painted);
    await shoot();
  }
  await mouse.up();
  await sheet.until("the release is recorded", (state) => state.revision !== revision);
  for (let k = 1; k <= STEPS.leave; k++) {
    const gone = eased(k / STEPS.leave);
    await mouse.move(start.x + (away.x - start.x) * gone, start.y + (away.y - start.y) * gone);
    await pause(60);
    await shoot();
  }
  if (sheet.complaints.length > 0) throw new Error(`the page reports ${sheet.complaints.join("\n")}`);
}

if (BROWSER === undefined) throw new Error("Chromium is not installed; CHROMIUM names its program");
const folder = process.env.FRAMES ?? mkdtempSync(join(tmpdir(), "pliant-drag-"));
mkdirSync(folder, { recursive: true });
let server;
let browser;
// This holds after a signal as well. The driver ends its browser when this process exits.
process.on("exit", () => {
  void server?.kill();
  if (process.env.FRAMES === undefined) rmSync(folder, { recursive: true });
});
for (const [signal, code] of [["SIGINT", 130], ["SIGTERM", 143]]) process.on(signal, () => process.exit(code));
try {
  server = await Server.start();
  browser = await launch();
  const sheet = await Sheet.open(browser, server.url, { viewport: PAGE, deviceScaleFactor: 1 });
  await record(sheet, folder);
  await browser.close();
  const joiner = fileURLToPath(new URL("join_frames.py", import.meta.url));
  const given = [joiner, folder, out, FRAMES_PER_SECOND, MOST_BYTES].map(String);
  execFileSync(process.env.PYTHON ?? "python3", given, { stdio: "inherit" });
} finally {
  await browser?.close();
  await server?.stop();
}
