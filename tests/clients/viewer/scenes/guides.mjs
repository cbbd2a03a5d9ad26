/** Curves and lattices: their points are drawn and dragged, the model follows, and undo, Escape and a reload know them. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { compare } from "./hold.mjs";
import { finger } from "../models.mjs";

export const title = "a curve and a lattice are made of a selection, and their points lead the model";

/** Drags a point of the guide that is shown by so many pixels; answers the state once it is recorded. */
async function lead(sheet, number, { x, y }) {
  const { revision, points } = await sheet.ask("state");
  const from = points[number].place;
  await sheet.drag([from, { x: from.x + x, y: from.y + y }], { steps: 12, pause: 20 });
  return sheet.until("the pose is recorded", (state) => state.revision !== revision && !state.busy);
}

export async function play({ browser, url, server, log }) {
  const sheet = await Sheet.open(browser, url());
  await sheet.drop(finger(2000));
  await sheet.until("the model opens", ({ link, busy }) => link === "open" && !busy);
  const rest = await sheet.positions();
  const { left, right, top, bottom } = await sheet.outline();
  await sheet.key("c");
  await sheet.page.mouse.click((left + right) / 2, (top + bottom) / 2);
  await sheet.page.getByRole("button", { name: "Curve", exact: true }).click();
  const straight = await sheet.until("five points are shown", ({ points, busy }) => points.length === 5 && !busy);
  await sheet.picture("guide-curve");

  const bent = await lead(sheet, 4, { x: 90, y: 30 });
  const shape = await sheet.positions();
  assert.ok(compare(shape, rest).worst > 0.05 * compare(shape, rest).diagonal, "the tip follows its point");
  const session = await sheet.ask("session");
  const { handles } = await server.json("GET", `/v1/sessions/${session}`);
  assert.equal(handles[0].pose.guide.positions.length, 15);
  await sheet.picture("guide-curve-bent");

  // A click moves nothing, and a drag that is given up leaves what was.
  await sheet.page.mouse.click(bent.points[0].place.x, bent.points[0].place.y);
  await sheet.page.mouse.move(bent.points[4].place.x, bent.points[4].place.y);
  await sheet.page.mouse.down();
  await sheet.page.mouse.move(bent.points[4].place.x - 60, bent.points[4].place.y, { steps: 6 });
  await sheet.key("Escape");
  await sheet.page.mouse.up();
  const given = await sheet.until("it is given up", ({ points, busy }) => !busy && points[4].at.every((x, k) => x === bent.points[4].at[k]));
  assert.equal(given.revision, bent.revision, "nothing is recorded");
  await sheet.key("Control+z");
  await sheet.until("it is straight again", ({ points, revision }) => revision !== bent.revision && points[4]?.at.every((x, k) => x === straight.points[4].at[k]));
  assert.ok(compare(await sheet.positions(), rest).worst < 1e-6 * compare(shape, rest).diagonal);
  await sheet.key("Control+Shift+z");
  await sheet.until("it is bent again", ({ revision }) => revision === bent.revision);
  await sheet.page.reload();
  await sheet.ready();
  const again = await sheet.until("it is back", ({ link, busy, points }) => link === "open" && !busy && points.length === 5);
  assert.deepEqual(again.points.map(({ at }) => at), bent.points.map(({ at }) => at), "a reload keeps the curve");

  // Keys look along the axes; a number that was typed leaves them to the page.
  const eye = async () => {
    const { eye, target } = await sheet.ask("camera");
    const away = eye.map((x, k) => x - target[k]);
    return away.map((x) => Math.round((100 * x) / Math.hypot(...away)) / 100);
  };
  for (const [key, seen] of [["1", [0, 0, 1]], ["3", [1, 0, 0]], ["9", [-1, 0, 0]], ["7", [0, 1, 0]], ["1", [0, 0, 1]]]) {
    await sheet.key(key);
    assert.deepEqual((await eye()).map((x) => x + 0), seen, `key ${key}`);
  }
  await sheet.page.getByLabel("Stiffness", { exact: true }).click({ clickCount: 3 });
  await sheet.page.keyboard.type("900\n");
  // The handle, and the shape that follows; undo and redo had revisions of their own.
  const after = (count) => String(Number(bent.revision) + count);
  await sheet.until("it is taken", ({ busy, revision }) => !busy && revision === after(4));
  await sheet.page.keyboard.press("Control+z");
  await sheet.until("the page undoes it", ({ busy, revision }) => !busy && revision === after(3));

  // A lattice in its place.
  await sheet.page.getByRole("button", { name: /^Remove Curve/ }).click();
  await sheet.until("no points are shown", ({ points }) => points.length === 0);
  await sheet.key("c");
  const outline = await sheet.outline();
  await sheet.page.mouse.click((outline.left + outline.right) / 2, (outline.top + outline.bottom) / 2);
  await sheet.page.getByRole("button", { name: "Lattice", exact: true }).click();
  const { points } = await sheet.until("points are shown", (state) => state.points.length === 36 && !state.busy);
  const upper = points.map(({ place }, k) => ({ ...place, k })).sort((a, b) => a.y - b.y)[0];
  const before = await sheet.positions();
  await lead(sheet, upper.k, { x: -60, y: -40 });
  const { worst, diagonal } = compare(await sheet.positions(), before);
  assert.ok(worst > 0.01 * diagonal, `a corner of the lattice moves the model by ${worst}`);
  await sheet.picture("guide-lattice");
  log(`the curve moved the tip by ${compare(shape, rest).worst.toFixed(2)}, the lattice by ${worst.toFixed(2)}`);
}
