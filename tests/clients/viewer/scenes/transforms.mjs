/** Hands that know other programs: G, R and S with axes, amounts and steps; views by keys and by the axes in the corner; fields. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { shows } from "./hold.mjs";
import { openSample } from "./sample.mjs";

export const title = "G, R and S move at once, along axes and by typed amounts; views lie along axes; fields let keys go";

export async function play({ browser, url, server, log }) {
  const sheet = await Sheet.open(browser, url());
  await openSample(sheet);
  await byPointer(sheet, server);
  await byNumbers(sheet, log);
  await inFields(sheet);
  await views(sheet);
  assert.deepEqual(sheet.complaints, []);
  await sheet.close();
}

const head = async (sheet) => (await sheet.ask("handles"))[1];
const near = (a, b, what) => assert.ok(a.every((x, k) => Math.abs(x - b[k]) < 1e-6), `${what}: ${a}, expected ${b}`);

/** Does something that ends in a commit. */
async function recorded(sheet, what, act) {
  const { revision } = await sheet.ask("state");
  await act();
  await sheet.until(`${what} is recorded`, (state) => state.revision !== revision);
  return (await head(sheet)).pose;
}

/** Undoes as often, and waits until the pose of before is back. */
async function undone(sheet, pose, times = 1) {
  for (let k = 0; k < times; k++) await sheet.undo();
  const same = (wanted) => JSON.stringify(window.pliantViewer.handles()[1].pose) === wanted;
  await sheet.page.waitForFunction(same, JSON.stringify(pose), { timeout: 10_000 });
}

async function keys(sheet, ...names) {
  for (const name of names) await sheet.key(name);
}

async function byPointer(sheet, server) {
  const { mouse, keyboard } = sheet.page;
  const session = await sheet.ask("session");
  const { at, pose } = await head(sheet);
  await mouse.move(at.x, at.y);
  await sheet.key("g");
  await mouse.move(at.x + 50, at.y - 30, { steps: 5 });
  const moved = await head(sheet);
  assert.ok(Math.abs(moved.at.x - at.x - 50) < 3 && Math.abs(moved.at.y - at.y + 30) < 3, `the handle follows without a button: ${JSON.stringify([at, moved.at])}`);
  // Locked to X, it stays on its line.
  await sheet.key("x");
  const onX = (await head(sheet)).pose.translation;
  assert.ok(onX[0] !== 0 && onX[1] === 0 && onX[2] === 0, `along X alone: ${onX}`);
  await sheet.picture("transform-x");
  await sheet.key("Shift+X");
  await mouse.move(at.x + 20, at.y + 40, { steps: 3 });
  const across = (await head(sheet)).pose.translation;
  assert.ok(across[0] === 0 && across[1] !== 0, `in the plane across X: ${across}`);
  await sheet.key("Escape");
  assert.deepEqual((await head(sheet)).pose, pose, "Escape gives it up");
  await shows(sheet, await server.floats("GET", `/v1/sessions/${session}/positions`));

  await sheet.key("g");
  await mouse.move(at.x - 40, at.y, { steps: 3 });
  await mouse.down({ button: "right" });
  await mouse.up({ button: "right" });
  assert.deepEqual((await head(sheet)).pose, pose, "the right button gives it up");

  // Steps of about a hundredth of the model, those of the fields, while Ctrl is down.
  const step = Number(await sheet.page.getByLabel("Move Y").getAttribute("step"));
  await mouse.move(at.x, at.y);
  await keys(sheet, "g", "y");
  await keyboard.down("Control");
  await mouse.move(at.x, at.y - 57, { steps: 3 });
  await keyboard.up("Control");
  const { translation: free } = (await head(sheet)).pose;
  await keyboard.down("Control");
  const { translation: even } = (await head(sheet)).pose;
  assert.ok(Math.abs(even[1] / step - Math.round(even[1] / step)) < 1e-6 && Math.abs(even[1] - free[1]) <= step * 0.51, `rounded: ${free[1]} to ${even[1]}`);
  const kept = await recorded(sheet, "a click", () => mouse.click(at.x, at.y - 57));
  await keyboard.up("Control");
  assert.deepEqual(kept.translation, even, "a click keeps what is shown");
  assert.equal((await sheet.ask("state")).selected, 0, "and does nothing else");
  await undone(sheet, pose);
}

async function byNumbers(sheet, log) {
  const rest = (await head(sheet)).pose;
  const moved = await recorded(sheet, "G X 0.2", () => keys(sheet, "g", "x", "0", ".", "2", "Enter"));
  near(moved.translation, [0.2, 0, 0], "G X 0.2 Enter");
  const back = await recorded(sheet, "G X -0.2", () => keys(sheet, "g", "x", "0", ".", "3", "Backspace", "2", "-", "Enter"));
  near(back.translation, [0, 0, 0], "typed, mended, made negative");
  // What was moved has turned a little; it is as it was.
  await undone(sheet, rest, 2);
  const turned = await recorded(sheet, "R Y 405", () => keys(sheet, "r", "y", "4", "0", "5", "Enter"));
  near(turned.rotation, [0, (405 / 180) * Math.PI, 0], "turns count");
  await keys(sheet, "r", "y", "9", "0");
  await sheet.page.locator(".tag", { hasText: "Y 90°" }).waitFor();
  await sheet.picture("transform-typed");
  await sheet.key("Escape");
  // Its own X has turned with it, from the model's X towards its −Z.
  const own = await recorded(sheet, "G X X 0.1", () => keys(sheet, "g", "x", "x", "0", ".", "1", "Enter"));
  const half = Math.SQRT1_2 / 10;
  near(own.translation, [half, 0, -half], "along its own X");
  const scaled = await recorded(sheet, "S Z 1.5", () => keys(sheet, "s", "z", "1", ".", "5", "Enter"));
  near(scaled.scale, [1, 1, 1.5], "scaled along Z");
  const flat = await recorded(sheet, "S Shift+Z 2", () => keys(sheet, "s", "Shift+Z", "2", "Enter"));
  near(flat.scale, [2, 2, 1.5], "scaled across Z");
  const { revision } = await sheet.ask("state");
  await keys(sheet, "g", "0", "Enter", "s", "1", "Enter");
  // What changes nothing is not recorded: four steps lead back.
  await undone(sheet, rest, 4);
  log(`six transforms by keys, back from revision ${revision}`);
}

async function inFields(sheet) {
  const { page } = sheet;
  const rest = (await head(sheet)).pose;
  const field = page.getByLabel("Move Y");
  await recorded(sheet, "a typed number", async () => {
    await field.fill("0.2");
    await sheet.key("Enter");
  });
  await undone(sheet, rest);
  // After Enter the page's keys work at once: Ctrl+S exports, and the browser does not save the page itself.
  const { revision } = await sheet.ask("state");
  await field.click();
  await page.keyboard.type("0.2");
  await page.evaluate(() => addEventListener("keydown", (event) => event.key === "s" && (window.leftToBrowser = !event.defaultPrevented), { once: false }));
  await sheet.key("Enter");
  const [download] = await Promise.all([page.waitForEvent("download"), sheet.key("Control+s")]);
  assert.match(download.suggestedFilename(), /\.glb$/);
  assert.equal(await page.evaluate(() => window.leftToBrowser), false, "the browser's own dialog stays away");
  await sheet.until("the number is recorded", (state) => state.revision !== revision);
  await undone(sheet, rest);
  assert.equal(await field.inputValue(), "0", "the field shows what holds");
  // In the field, too: what is typed and not taken is dropped, and the step before is undone.
  await recorded(sheet, "a typed number", async () => {
    await field.fill("0.3");
    await sheet.key("Enter");
  });
  await field.click();
  await undone(sheet, rest);
  assert.equal(await field.inputValue(), "0", "the field shows what holds");
  for (const axis of ["X", "Y", "Z"]) assert.equal(await page.locator(".vector label > span", { hasText: axis }).count(), 3, `three fields say ${axis}`);
}

async function views(sheet) {
  const { page } = sheet;
  const along = async () => {
    const { eye, target } = await sheet.ask("camera");
    const away = eye.map((x, k) => x - target[k]);
    return away.map((x) => Math.round((x / Math.hypot(...away)) * 100) / 100 + 0);
  };
  const corner = (from) => page.getByRole("button", { name: `View from the ${from}` });
  for (const [key, from, wanted] of [["1", "front", [0, 0, 1]], ["3", "right", [1, 0, 0]], ["7", "top", [0, 1, 0]]]) {
    await keys(sheet, "f", "9", key);
    assert.deepEqual(await along(), wanted, `key ${key}`);
    await keys(sheet, "ArrowLeft", "ArrowDown");
    await corner(from).click();
    assert.deepEqual(await along(), wanted, `the axis that looks from the ${from}`);
    await page.waitForTimeout(100);
    await corner(from).click();
    assert.deepEqual(await along(), wanted.map((x) => -x + 0), "a second click looks from the other side");
  }
  await sheet.picture("views");
  await page.getByRole("button", { name: "Frame the model" }).click();
}
