/**
 * The notebook widget of the Python package in Chromium, without Jupyter: `node page.mjs PICTURES dark|light`.
 *
 * Lines of JSON come on stdin and go to stdout, in which binary values are {"base64": …}: `state` and `custom` are what the widget sends to its
 * front end and what comes back; `scene` is how a drag is going. proto/clients/python/tests/test_notebook.py is at the other end.
 */

import { createInterface } from "node:readline";
import { readFileSync } from "node:fs";
import { launch } from "../viewer/browser.mjs";

const [, , pictures, colorScheme] = process.argv;
const say = (line) => process.stdout.write(`${JSON.stringify(line)}\n`);
const front = new URL("../../../proto/clients/python/pliant/", import.meta.url);

const browser = await launch();
const context = await browser.newContext({ viewport: { width: 760, height: 460 }, colorScheme });
const page = await context.newPage();
const complaints = [];
page.on("console", (message) => ["error", "warning"].includes(message.type()) && complaints.push(message.text()));
page.on("pageerror", (error) => complaints.push(String(error)));
// The page, and nothing else: the widget asks for no other file.
const asked = [];
const html = `<!doctype html><meta name="color-scheme" content="light dark"><style>${readFileSync(new URL("notebook.css", front))}</style><main></main>`;
await page.route("**", (route) => {
  const url = route.request().url();
  if (url === "http://notebook.test/") return route.fulfill({ contentType: "text/html", body: html });
  if (url === "http://notebook.test/notebook.js") {
    return route.fulfill({ contentType: "text/javascript", body: readFileSync(new URL("notebook.js", front), "utf8") });
  }
  asked.push(url);
  return route.abort();
});
await page.exposeFunction("toPython", say);
await page.goto("http://notebook.test/");
await page.evaluate(() => {
  const state = {};
  const listeners = new Map();
  const hear = (event, ...said) => [...(listeners.get(event) ?? [])].forEach((listener) => listener(...said));
  // Views of bytes that do not begin where their buffer does, as those of Jupyter.
  const bytes = (text) => new DataView(Uint8Array.from(` ${atob(text)}`, (c) => c.charCodeAt(0)).buffer, 1);
  const read = (value) => (value?.base64 === undefined ? value : bytes(value.base64));
  window.fromPython = ({ state: newer, custom, buffers = [] }) => {
    if (custom !== undefined) return hear("msg:custom", custom, buffers.map(read));
    const changed = Object.keys(newer ?? {});
    for (const name of changed) state[name] = read(newer[name]);
    for (const name of changed) hear(`change:${name}`);
  };
  window.model = {
    get: (name) => state[name],
    set: (name, value) => (state[name] = value),
    save_changes: () => undefined,
    on: (event, listener) => listeners.set(event, [...(listeners.get(event) ?? []), listener]),
    off: (event, listener) => listeners.set(event, (listeners.get(event) ?? []).filter((other) => other !== listener)),
    send: (content) => window.toPython({ custom: content }),
  };
});
const python = createInterface({ input: process.stdin });
const waiting = [];
python.on("line", (line) => {
  const message = JSON.parse(line);
  if (message.go !== undefined) waiting.shift()?.(message.go);
  else void page.evaluate((heard) => window.fromPython(heard), message);
});
/** What Python answers to how far the scene is. */
const told = (scene) => new Promise((resolve) => [waiting.push(resolve), say({ scene })]);

const status = () => page.locator(".pliant [role=status]").textContent();
const until = async (what, test) => {
  for (let k = 0; !(await test()); k++) {
    if (k > 600) throw new Error(`${what}: still ${await page.locator(".pliant").innerText()}; ${complaints}`);
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
};
const revision = (number) => until(`revision ${number}`, async () => (await status()).endsWith(`revision ${number}`));
const picture = async (name) => {
  // Two frames of the page: what came is drawn. Without the ring around the dot that was clicked.
  await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));
  await page.evaluate(() => document.querySelector(".held") ?? document.activeElement.blur());
  return page.locator(".pliant").screenshot({ path: `${pictures}/notebook-${colorScheme}-${name}.png` });
};
const dot = (id) => page.locator(".pliant .handle", { hasText: id });
const middle = async (locator) => {
  const { x, y, width, height } = await locator.boundingBox();
  return { x: x + Math.min(width, 18) / 2, y: y + height / 2 };
};
/** Grabs a handle and moves the pointer in steps. */
async function drag(id, right, down, { shift = false, steps = 3, each = async () => undefined } = {}) {
  const { x, y } = await middle(dot(id));
  if (shift) await page.keyboard.down("Shift");
  await page.mouse.move(x, y);
  await page.mouse.down();
  for (let step = 1; step <= steps; step++) {
    const before = answers();
    await page.mouse.move(x + (right * step) / steps, y + (down * step) / steps, { steps: 4 });
    await until("a frame", async () => answers() > before);
    await each(step);
  }
  if (shift) await page.keyboard.up("Shift");
}
let answered = 0;
const answers = () => answered;
python.on("line", (line) => (answered += JSON.parse(line).custom === undefined ? 0 : 1));

await told("ready");
await page.evaluate(async () => {
  const { default: widget } = await import("/notebook.js");
  window.cleanUp = await widget.render({ model: window.model, el: document.querySelector("main") });
});
const first = Number((await status()).split(" ").at(-1));
await picture("0-shown");

await drag("head", 30, -60, { each: (step) => picture(`${step}-dragged`) });
await page.mouse.up();
await revision(first + 1);
await picture("4-released");
await told("moved");

await drag("head", 60, 0, { shift: true });
await page.mouse.up();
await revision(first + 2);
const turned = await picture("5-turned");
await told("turned");

await drag("tail", -40, -80);
await page.keyboard.press("Escape");
await page.mouse.up();
await until("the drag is taken back", async () => (await page.locator(".handle.held").count()) === 0);
await told("taken back");
const isTakenBack = turned.equals(await picture("6-taken-back"));

await page.getByRole("button", { name: "Undo" }).click();
await until("the undo", async () => !(await status()).endsWith(`revision ${first + 2}`));
await told("undone");

// Around, closer, and all of it again.
await page.mouse.move(150, 380);
await page.mouse.down();
await page.mouse.move(330, 340, { steps: 5 });
await page.mouse.up();
await page.mouse.wheel(0, -300);
await picture("7-orbited");
await page.getByRole("button", { name: "Frame" }).click();

// What another cell did to the session is refused or taken over.
await told("edited elsewhere");
await drag("head", 40, 0, { steps: 1 });
await page.mouse.up();
const alert = page.locator(".pliant [role=alert]");
await until("the error", () => alert.isVisible());
await picture("8-error");
const refusal = await alert.textContent();

await page.evaluate(() => window.cleanUp());
say({ scene: "end", refusal, isTakenBack, complaints, asked });
await browser.close();
process.exit(0);
