/** Clips play on the shape as it is bent, and give way to editing. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { dancingBar } from "../gltf.mjs";

export const title = "clips play on the bent shape, broken ones do no harm";

/** Moves the slider of the clip. */
async function seek(sheet, seconds) {
  await sheet.page.getByLabel("Time in the clip").evaluate((input, value) => {
    input.value = String(value);
    input.dispatchEvent(new Event("input", { bubbles: true }));
  }, seconds);
  return sheet.positions();
}

/** The mean of the last four vertices, which hang on the moving joint. */
const tip = (positions) => [0, 1, 2].map((axis) => [4, 3, 2, 1].reduce((sum, k) => sum + positions.at(-3 * k + axis) / 4, 0));
const near = (a, b, what, slack = 1e-3) => assert.ok(Math.hypot(...a.map((x, k) => x - b[k])) < slack, `${what}: ${a} is not ${b}`);

export async function play({ browser, url, server }) {
  const sheet = await Sheet.open(browser, url());
  await sheet.pick(dancingBar());
  await sheet.until("the clips are there", ({ clips, busy }) => clips === 5 && !busy);
  const rest = await sheet.positions();
  const options = await sheet.page.getByLabel("Clip", { exact: true }).locator("option").allInnerTexts();
  assert.deepEqual(options, ["across", "steps", "curve", "broken (moves nothing)", "empty (moves nothing)"]);

  await sheet.key("Space");
  await sheet.until("the clip runs", ({ seconds }) => seconds > 0.05);
  near(tip(await seek(sheet, 1)), [1, 4, 0], "half-way across", 0.01);
  await sheet.picture("clip-across");
  const choose = (name) => sheet.page.getByLabel("Clip", { exact: true }).selectOption(name);
  await choose("steps");
  near(tip(await seek(sheet, 1.9)), [0, 4, 0], "a step waits for its key");
  near(tip(await seek(sheet, 2)), [0, 5, 0], "and is taken at once");
  await choose("curve");
  // Hermite's polynomial: the tangent out of the first key adds an eighth of it times the two seconds.
  near(tip(await seek(sheet, 1)), [1.25, 4, 0], "half-way along the curve", 0.01);
  await choose("broken (moves nothing)");
  assert.deepEqual(tip(await sheet.positions()), tip(rest), "a clip with times that are not numbers moves nothing");
  await sheet.page.getByText("1 of 1 channels have broken times").waitFor();
  await choose("empty (moves nothing)");
  assert.deepEqual(await sheet.positions(), rest);

  // Another tool, and the shape is the one that is edited.
  await choose("across");
  await seek(sheet, 2);
  await sheet.key("x");
  await sheet.until("the clip is closed", ({ seconds }) => seconds < 0);
  assert.deepEqual(await sheet.positions(), rest);

  assert.deepEqual(sheet.complaints, []);
  await sheet.close();

  // Bent by somebody else, and taken up here: the clip begins from there.
  const bar = dancingBar();
  const { id } = await server.json("POST", "/v1/sessions", bar.buffer, bar.mimeType);
  const path = `/v1/sessions/${id}`;
  const within = (min, max) => ({ box: { min, max } });
  const handles = [{ id: "foot", region: within([-9, -9, -9], [9, 0.6, 9]) }, { id: "top", region: within([-9, 3.4, -9], [9, 9, 9]) }];
  await server.json("PUT", `${path}/handles`, { handles });
  await server.floats("POST", `${path}/solve`, { pose: { handles: [{ id: "top", pose: { translation: [0, 1.5, 0] } }] } });
  const other = await Sheet.open(browser, `${url()}/?session=${id}`);
  await other.until("the bent shape is shown", ({ link, clips, busy }) => link === "open" && clips === 5 && !busy);
  const bent = await other.positions();
  assert.ok(tip(bent)[1] > 5.4, `the bar is longer: ${tip(bent)}`);
  await other.key("Space");
  await other.until("the clip runs", ({ seconds }) => seconds >= 0);
  const start = tip(await seek(other, 0));
  const end = tip(await seek(other, 2));
  near([end[0] - start[0], end[1] - start[1], end[2] - start[2]], [2, 0, 0], "the clip moves the bent shape as it moved the first", 0.05);
  await other.picture("clip-bent");
  await other.key("Escape");
  assert.deepEqual(await other.positions(), bent);
  assert.deepEqual(other.complaints, []);
  await other.close();
}
