/** A recording is refused because joints are not sure: they are shown, dragged to where they belong, and the clip plays. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { Sheet } from "../browser.mjs";
import { dataFile } from "../models.mjs";
import { nodding, waving } from "../recordings.mjs";
import { openSample } from "./sample.mjs";

export const title = "joints that are not sure are shown and dragged to where they belong, and the next clip plays by them";

const jointOf = ({ rig }, name) => rig.find((joint) => joint.name === name);

export async function play({ browser, url, server, log }) {
  await correct({ browser, url, server, log });
  await ofAFile({ browser, url });
}

/** Moves a joint by so many pixels; answers what is shown when the server has looked again. */
async function put(sheet, name, { x, y }) {
  const before = jointOf(await sheet.ask("state"), name);
  const { place } = before;
  await sheet.drag([place, { x: place.x + x, y: place.y + y }], { steps: 6 });
  await sheet.page.getByText("searching again").waitFor({ state: "detached" });
  return sheet.until(`${name} is put`, (state) => state.rig !== null && jointOf(state, name).given && !state.busy);
}

async function correct({ browser, url, server, log }) {
  const file = dataFile("meshes/cheburashka.off");
  if (file === undefined) return log("SKIPPED: cheburashka.off is not among the models");
  const sheet = await Sheet.open(browser, url());
  await sheet.pick({ name: "cheburashka.off", mimeType: "application/octet-stream", buffer: readFileSync(file) });
  await sheet.until("it is open", ({ vertices, busy, link }) => vertices > 0 && !busy && link === "open");
  const rest = await sheet.positions();
  await sheet.drop(waving(6));
  const { rig } = await sheet.until("joints are shown", (state) => state.rig !== null && !state.busy);
  const doubtful = rig.filter((joint) => joint.doubtful);
  assert.ok(doubtful.length > 0 && doubtful.every(({ score }) => score < 0.5), JSON.stringify(rig));
  assert.ok(rig.some((joint) => !joint.doubtful), "others are sure");
  const animate = sheet.page.locator(".transport.rig").getByRole("button", { name: "Animate" });
  assert.ok(await animate.isDisabled(), "not by such joints");
  await sheet.picture("rig-doubtful");

  // Dragged, a joint stays where it was dropped, and the server looks at the others again.
  const [{ name, at }] = doubtful;
  const moved = jointOf(await put(sheet, name, { x: 12, y: -8 }), name);
  assert.ok(moved.at.some((x, k) => Math.abs(x - at[k]) > 1e-3 * Math.abs(at[k])), `${name} has moved`);
  assert.deepEqual([moved.score, moved.doubtful], [1, false]);
  // Those that are right are clicked on, faster than the server looks.
  for (let clicks = 0; ; clicks++) {
    const next = (await sheet.ask("state")).rig.find((joint) => joint.doubtful);
    if (next === undefined) break;
    assert.ok(clicks < 4 * rig.length, `${next.name} cannot be clicked on`);
    await sheet.page.mouse.click(next.place.x, next.place.y);
  }
  await sheet.page.getByText("searching again").waitFor({ state: "detached" });
  assert.ok((await sheet.ask("state")).rig.every((joint) => !joint.doubtful), "all are sure");
  const given = (await sheet.ask("state")).rig.filter((joint) => joint.given);
  log(`${doubtful.length} joints were not sure, ${given.length} were put by hand`);
  assert.deepEqual(jointOf(await sheet.ask("state"), name).at, moved.at, "it stays where it was put");
  await sheet.picture("rig-corrected");
  await animate.click();
  const { animation } = await sheet.until("all frames are there", (state) => state.animation !== null && state.animation.kept === state.animation.wanted && !state.animation.coming);
  assert.equal(animation.kept, 6);
  await sheet.picture("rig-animated");
  await sheet.key("Escape");
  assert.deepEqual(await sheet.positions(), rest, "it leaves no trace");
  const id = await sheet.ask("session");
  assert.equal((await server.json("GET", `/v1/sessions/${id}/history`)).commits.length, 1);
  // The next recording of the same body plays at once.
  await sheet.drop(waving(4, "again.bvh"));
  await sheet.until("its frames come", (state) => state.animation?.wanted === 4 && state.animation.kept === 4);
  await sheet.close();
}

/** The joints of a rig file are shown and dragged, too. */
async function ofAFile({ browser, url }) {
  const sheet = await Sheet.open(browser, url());
  await openSample(sheet);
  await sheet.pick(...nodding(3));
  await sheet.until("it nods", (state) => state.animation !== null && state.animation.kept === 3);
  await sheet.page.locator("summary", { hasText: "Animation" }).click();
  await sheet.page.getByRole("button", { name: "Joints…" }).click();
  const shown = await sheet.until("its joints are shown", (state) => state.rig !== null);
  assert.deepEqual(shown.rig.map(({ name }) => name).sort(), ["neck", "nose", "tail"]);
  const { place, at } = jointOf(shown, "neck");
  const camera = await sheet.ask("camera");
  await sheet.drag([place, { x: place.x + 30, y: place.y - 20 }], { steps: 6 });
  const moved = jointOf(await sheet.ask("state"), "neck");
  assert.ok(Math.hypot(...moved.at.map((x, k) => x - at[k])) > 0.01, "it is dragged");
  assert.ok(Math.hypot(moved.place.x - place.x - 30, moved.place.y - place.y + 20) < 3, "with the pointer");
  assert.deepEqual(await sheet.ask("camera"), camera, "and nothing else moves");
  await sheet.picture("rig-file");
  await sheet.page.locator(".transport.rig").getByRole("button", { name: "Animate" }).click();
  await sheet.until("it nods by it", (state) => state.animation !== null && state.animation.kept === 3);
  await sheet.key("Escape");
  assert.deepEqual(sheet.complaints, []);
  await sheet.close();
}
