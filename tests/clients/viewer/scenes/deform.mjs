/** Open a model, hold it by mouse, drag: what is on the screen is what `Solve` says. */

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { Sheet } from "../browser.mjs";
import { dataFile } from "../models.mjs";
import { asHandles, asPose, compare, dragGrip, holdBothEnds, shows } from "./hold.mjs";

/** Small, closed, of the data folder. */
const MODEL = "gltf/Duck.glb";

export const title = "a model is held and dragged by mouse, and lies where Solve says";

export async function play({ browser, url, server, log }) {
  const sheet = await Sheet.open(browser, url());
  const file = dataFile(MODEL);
  let model;
  if (file === undefined) {
    log(`SKIPPED: ${MODEL} is not in the data folder; the sample creature takes its place`);
    model = new Uint8Array(await (await fetch(`${server.url}/v1/sample.glb`)).arrayBuffer());
    await sheet.pick({ name: "creature.glb", mimeType: "model/gltf-binary", buffer: Buffer.from(model) });
  } else {
    model = await readFile(file);
    await sheet.pick(file);
  }
  await sheet.until("the model opens", ({ link, busy }) => link === "open" && !busy);
  const rest = await sheet.positions();

  const grip = await holdBothEnds(sheet);
  const after = await dragGrip(sheet, grip, [{ x: 90, y: -60 }]);
  log(`dragged ${after.vertices} vertices; solve ${after.solveMs.toFixed(1)} ms, ${after.superseded} superseded`);
  const handles = await sheet.ask("handles");
  const { pose, vertices } = handles[1];
  assert.ok(Math.hypot(...pose.translation) > 0, "the grip has moved");

  // The same model, handles and pose in a session of their own, solved by one call.
  const session = await server.json("POST", "/v1/sessions", model, "model/gltf-binary");
  await server.json("PUT", `/v1/sessions/${session.id}/handles`, { handles: asHandles(handles) });
  const solved = await server.floats("POST", `/v1/sessions/${session.id}/solve`, {
    pose: { handles: [{ id: handles[1].id, pose: asPose(handles[1]) }] },
    options: { tolerance: 1e-4 },
  });
  const { worst, diagonal } = await shows(sheet, solved);
  log(`shown and solved differ by ${(worst / diagonal).toExponential(1)} of the box at most`);
  assert.equal(worst, 0, "what is drawn is what Solve answers, to the bit");
  const moved = compare(solved, rest);
  assert.ok(moved.worst > 0.05 * moved.diagonal, `the shape has moved by ${moved.worst}`);
  await server.json("DELETE", `/v1/sessions/${session.id}`).catch(() => undefined);

  // What the page paints at the place of a gripped vertex is the handle's colour, not the background.
  await sheet.key("v");
  const places = (await Promise.all(vertices.map((v) => sheet.ask("place", v)))).filter((place) => place !== undefined);
  const colours = await sheet.colours(places);
  const blue = colours.filter(([r, , b]) => b > r + 40).length;
  log(`${blue} of ${places.length} gripped vertices show the grip's colour where they were projected to`);
  assert.ok(blue > places.length / 4, "the grip is drawn where its vertices are");
  await sheet.picture("dragged");

  await sheet.key("Control+z");
  await sheet.until("undo arrives", ({ revision }) => revision !== after.revision);
  await sheet.page.waitForFunction(() => window.pliantViewer.handles()[1].pose.translation.every((x) => x === 0));
  assert.equal((await shows(sheet, rest)).worst, 0, "undo goes back to the bit");
  await sheet.key("Control+y");
  await sheet.page.waitForFunction(() => window.pliantViewer.handles()[1].pose.translation.some((x) => x !== 0));
  assert.equal((await shows(sheet, solved)).worst, 0, "redo goes forward to the bit");

  const saved = sheet.page.waitForEvent("download");
  await sheet.key("Control+s");
  const download = await saved;
  assert.match(download.suggestedFilename(), /-bent\.glb$/);
  const exported = await readFile(await download.path());
  assert.equal(exported.subarray(0, 4).toString(), "glTF");
  assert.deepEqual(sheet.complaints, []);
  await sheet.close();
}
