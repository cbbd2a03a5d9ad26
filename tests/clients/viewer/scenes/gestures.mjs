/** What the hand does: a lasso that closes, a way that comes back, undo in the hand's order, Escape in mid-drag, the mouse's buttons. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { dragGrip, shows, takeGrip } from "./hold.mjs";
import { openSample } from "./sample.mjs";

export const title = "a closed lasso selects; undo follows the hand and says so; Escape gives up; buttons mean the same with every tool";

export async function play({ browser, url, server, log }) {
  const sheet = await Sheet.open(browser, url());
  await openSample(sheet);
  await closedLasso(sheet);
  await undoFollowsTheHand(sheet, server);
  await escapeGivesUp(sheet, server);
  await buttonsAreTheSame(sheet, log);
  assert.deepEqual(sheet.complaints, []);
  await sheet.close();
}

const selectedOf = async (sheet) => (await sheet.ask("state")).selected;

/** A ring around a place, that ends where it began. */
function ring({ x, y }, radius) {
  const at = (k) => ({ x: x + radius * Math.cos(k / 2), y: y + radius * Math.sin(k / 2) });
  return [...Array.from({ length: 13 }, (_, k) => at(k)), at(0)];
}

async function closedLasso(sheet) {
  const [, head] = await sheet.ask("handles");
  await sheet.key("l");
  await sheet.drag(ring(head.at, 60), { steps: 3 });
  assert.ok((await selectedOf(sheet)) > 0, "a lasso that is released where it began selects what it encloses");
  await sheet.page.mouse.click(head.at.x, head.at.y);
  assert.equal(await selectedOf(sheet), 0, "a click clears");

  // A way that comes back is no click on what lies there.
  await sheet.tool("Move the handle");
  await sheet.key("n");
  const active = () => sheet.page.locator(".handles li.active .name").innerText();
  const chosen = await active();
  const [feet] = await sheet.ask("handles");
  const away = { x: feet.at.x + 80, y: feet.at.y + 20 };
  await sheet.drag([feet.at, away, feet.at]);
  assert.equal(await active(), chosen, "looking around and back chooses nothing");
  await sheet.key("f");
}

/** Presses undo or redo, and waits until the page says what that was. */
async function travels(sheet, key, says) {
  await sheet.key(key);
  await sheet.page.locator(".notice", { hasText: says }).waitFor();
}

async function undoFollowsTheHand(sheet, server) {
  const session = await sheet.ask("session");
  const named = async () => (await sheet.ask("handles")).map(({ name }) => name);
  const [, head] = await sheet.ask("handles");
  const told = async () => (await server.json("GET", `/v1/sessions/${session}`)).handles.length;

  // A handle, then two selections: undo takes the selections back, one by one, and then the handle.
  await sheet.key("l");
  await sheet.drag(ring({ x: head.at.x - 40, y: head.at.y + 90 }, 40), { steps: 3 });
  const first = await selectedOf(sheet);
  assert.ok(first > 0);
  await sheet.key("p");
  await sheet.page.waitForFunction(() => window.pliantViewer.handles().length === 3);
  const { revision } = await sheet.until("the pin is recorded", (state) => state.revision === "4" || state.revision === "3");
  const made = (await named())[2];
  await sheet.drag(ring(head.at, 50), { steps: 3 });
  const lassoed = await selectedOf(sheet);
  await sheet.key("b");
  await sheet.drag([{ x: head.at.x - 40, y: head.at.y + 60 }, { x: head.at.x + 40, y: head.at.y + 60 }]);
  const painted = await selectedOf(sheet);
  assert.ok(lassoed > 0 && painted > lassoed, `${lassoed}, then ${painted} are selected`);

  const button = sheet.page.getByRole("button", { name: "Undo: Brush stroke" });
  await button.waitFor();
  await travels(sheet, "Control+z", "Undone: Brush stroke");
  await sheet.picture("undone");
  assert.equal(await selectedOf(sheet), lassoed);
  await travels(sheet, "Control+z", "Undone: Selection by lasso");
  assert.equal(await selectedOf(sheet), 0);
  assert.equal((await sheet.ask("state")).revision, revision, "the server's commits are as they were");
  assert.equal(await told(), 3, "and no handle is gone");
  await travels(sheet, "Control+z", `Undone: ${made} made`);
  assert.equal(await told(), 2);
  assert.equal(await selectedOf(sheet), first, "what the handle was made of is selected again");

  await travels(sheet, "Control+y", `Redone: ${made} made`);
  await travels(sheet, "Control+y", "Redone: Selection by lasso");
  assert.equal(await selectedOf(sheet), lassoed);
  await travels(sheet, "Control+y", "Redone: Brush stroke");
  assert.equal(await selectedOf(sheet), painted);
  assert.deepEqual(await named(), ["Feet", "Head", made]);
  for (const says of ["Undone: Brush stroke", "Undone: Selection by lasso", `Undone: ${made} made`]) await travels(sheet, "Control+z", says);
  await sheet.key("Escape");
}

async function escapeGivesUp(sheet, server) {
  const session = await sheet.ask("session");
  const { mouse } = sheet.page;
  const history = async () => (await server.json("GET", `/v1/sessions/${session}/history`)).commits.map(({ revision }) => revision);
  await sheet.tool("Move the handle");
  await sheet.page.getByRole("button", { name: "Head", exact: false }).first().click();
  const [, before] = await sheet.ask("handles");
  await dragGrip(sheet, before, [{ x: 20, y: 10 }]);
  const shape = await server.floats("GET", `/v1/sessions/${session}/positions`);
  await shows(sheet, shape);
  const commits = await history();
  const head = await takeGrip(sheet);
  for (let k = 1; k <= 10; k++) await mouse.move(head.at.x + 6 * k, head.at.y - 4 * k);
  await sheet.page.waitForFunction((was) => JSON.stringify(window.pliantViewer.handles()[1].pose) !== was, JSON.stringify(head.pose));
  await sheet.key("Escape");
  for (let k = 10; k >= 1; k--) await mouse.move(head.at.x + 4 * k, head.at.y + 3 * k);
  await mouse.up();
  const [, after] = await sheet.ask("handles");
  assert.deepEqual(after.pose, head.pose, "the handle is where it was");
  assert.deepEqual(after.at, head.at, "and so is the camera");
  assert.equal((await shows(sheet, shape)).worst, 0, "the shape is that of the last commit, to the bit");
  assert.deepEqual(await history(), commits, "nothing is recorded");

  // The next drag is as if the one that was given up had never been.
  await dragGrip(sheet, after, [{ x: -15, y: 25 }]);
  const [, again] = await sheet.ask("handles");
  assert.notDeepEqual(again.pose, head.pose);
  assert.equal((await history()).length, commits.length + 1);
  await shows(sheet, await server.floats("GET", `/v1/sessions/${session}/positions`));
  await travels(sheet, "Control+z", "Undone: Head posed");
  assert.equal((await shows(sheet, shape)).worst, 0);

  // A stroke is given up as well, and Escape leaves what was selected before it.
  await sheet.key("b");
  await sheet.drag([head.at, { x: head.at.x + 10, y: head.at.y }]);
  const selected = await selectedOf(sheet);
  assert.ok(selected > 0);
  await mouse.move(head.at.x - 60, head.at.y + 60);
  await mouse.down();
  await mouse.move(head.at.x - 20, head.at.y + 90, { steps: 6 });
  assert.ok((await selectedOf(sheet)) > selected);
  await sheet.key("Escape");
  await mouse.move(head.at.x + 20, head.at.y + 90, { steps: 4 });
  await mouse.up();
  assert.equal(await selectedOf(sheet), selected, "what was selected before the stroke is");
  await sheet.key("Escape");
  assert.equal(await selectedOf(sheet), 0, "with no stroke under way, Escape clears");
}

/** What became of the camera: it went around its target (turn), beside it with it (pan), or nearer to it (zoom). */
function motion(before, after) {
  const away = ({ eye, target }) => eye.map((x, k) => x - target[k]);
  const [was, is] = [away(before), away(after)];
  const far = Math.hypot(...was);
  const nearer = Math.abs(Math.hypot(...is) / far - 1);
  const turned = Math.hypot(...is.map((x, k) => x / Math.hypot(...is) - was[k] / far));
  const moved = Math.hypot(...after.target.map((x, k) => x - before.target[k])) / far;
  const seen = [[turned, "turn"], [nearer, "zoom"], [moved, "pan"]].filter(([much]) => much > 1e-3).map(([, name]) => name);
  // The wheel zooms to the pointer, which takes the target along.
  return seen.join() === "zoom,pan" ? "zoom" : seen.join() || "nothing";
}

async function buttonsAreTheSame(sheet, log) {
  const { page } = sheet;
  const { mouse, keyboard } = page;
  const camera = () => sheet.ask("camera");
  const middle = await page.locator(".canvas").boundingBox().then(({ x, y, width, height }) => ({ x: x + width / 2, y: y + height / 2 }));
  /** What dragging with a button does to the camera. */
  const does = async (button, holding) => {
    await sheet.key("f");
    const before = await camera();
    if (holding) await keyboard.down(holding);
    await mouse.move(middle.x + 150, middle.y + 150);
    await mouse.down({ button });
    await mouse.move(middle.x + 200, middle.y + 150, { steps: 4 });
    await mouse.up({ button });
    if (holding) await keyboard.up(holding);
    return motion(before, await camera());
  };
  const wheel = async () => {
    await sheet.key("f");
    const before = await camera();
    await mouse.move(middle.x, middle.y);
    await mouse.wheel(0, -900);
    await page.waitForFunction((was) => String(window.pliantViewer.camera().eye) !== was, String(before.eye));
    return motion(before, await camera());
  };
  const { revision } = await sheet.ask("state");
  const selects = async () => ["brush", "box", "lasso", "part", "remesh"].includes(await page.locator(".canvas canvas").getAttribute("data-tool"));
  const checks = async (turns, pans) => {
    for (const tool of await page.locator(".rail button").all()) {
      await tool.click();
      const seen = [await does(turns), await does(turns, "Shift"), await does(pans), await wheel()];
      assert.deepEqual(seen, ["turn", "pan", "pan", "zoom"], `with the tool ${await tool.getAttribute("title")}: ${turns}, Shift and ${turns}, ${pans}, wheel`);
      if (!(await selects())) assert.deepEqual([await does("left"), await does("left", "Shift")], ["turn", "pan"], `with the tool ${await tool.getAttribute("title")}: left, Shift and left`);
    }
  };
  const hint = (words) => page.getByText(words).first().waitFor();
  await sheet.key("f");
  await checks("middle", "right");
  await hint("The middle button orbits, and so does the left one unless the tool selects; with Shift they pan, as the right button does; the wheel zooms.");
  await page.getByRole("radio", { name: "right button" }).click();
  await checks("right", "middle");
  await hint("The right button orbits, and so does the left one unless the tool selects; with Shift they pan, as the middle button does; the wheel zooms.");
  const after = await sheet.ask("state");
  assert.deepEqual([after.selected, after.revision], [0, revision], "looking around selects and records nothing");
  log("9 tools, 2 habits: every button does the same");
}
