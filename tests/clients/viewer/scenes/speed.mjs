/**
 * Large models: shapes painted in a second while dragging. Measured, not judged: this browser draws without a card. The larger one
 * is for whoever asks for this scene by name: run speed.
 */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { finger } from "../models.mjs";
import { asHandles, asPose, compare, holdBothEnds, shows } from "./hold.mjs";

/** How long each model is dragged. */
const DRAG_SECONDS = 4;

export const title = "50 K vertices, and 300 K when asked for, are dragged live";

export async function play({ browser, url, server, log, named }) {
  for (const vertices of named ? [50_000, 300_000] : [50_000]) {
    const sheet = await Sheet.open(browser, url(), { viewport: { width: 1000, height: 640 } });
    const model = finger(vertices);
    const begun = performance.now();
    await sheet.pick(model);
    await sheet.until("the model opens", ({ link, busy }) => link === "open" && !busy);
    const opened = performance.now() - begun;
    const grip = await holdBothEnds(sheet);
    const frames = await watch(sheet);
    const seen = await dragFor(sheet, grip, DRAG_SECONDS, frames);
    const after = await sheet.until("the release is recorded", ({ revision }) => revision === "4");
    log(
      `${after.vertices} vertices: open ${(opened / 1000).toFixed(1)} s; while dragging ${seen.shapes} shapes in ` +
        `${seen.seconds.toFixed(1)} s = ${(seen.shapes / seen.seconds).toFixed(1)} a second; ` +
        `last solve ${after.solveMs.toFixed(0)} ms; ${after.superseded} poses superseded; ` +
        `page busy ${seen.takeMs.toFixed(1)} ms a shape without drawing`,
    );
    const handles = await sheet.ask("handles");
    const session = await server.json("POST", "/v1/sessions?format=ply", model.buffer, "application/octet-stream");
    await server.json("PUT", `/v1/sessions/${session.id}/handles`, { handles: asHandles(handles) });
    const solved = await server.floats("POST", `/v1/sessions/${session.id}/solve`, {
      pose: { handles: [{ id: handles[1].id, pose: asPose(handles[1].pose) }] },
    });
    // Frames of large models are 16-bit numbers between the corners of their box.
    const { worst, diagonal } = await shows(sheet, solved, compare(solved, solved).diagonal / 65535);
    assert.ok(worst <= diagonal / 65535, `shown and solved differ by ${worst / diagonal} of the box`);
    await server.json("DELETE", `/v1/sessions/${session.id}`).catch(() => undefined);
    await sheet.picture(`finger-${vertices / 1000}k`);
    assert.deepEqual(sheet.complaints, []);
    await sheet.page.getByRole("button", { name: "Close the model" }).click();
    await sheet.close();
  }
}

/** Leads the grip around for some seconds; answers what was seen until the mouse let go. */
async function dragFor(sheet, grip, seconds, frames) {
  const { mouse } = sheet.page;
  await mouse.move(grip.at.x, grip.at.y);
  await mouse.down();
  const until = performance.now() + seconds * 1000;
  for (let k = 0; performance.now() < until; k++) {
    await mouse.move(grip.at.x + 60 * Math.sin(k / 12), grip.at.y + 40 * Math.sin(k / 18));
    await new Promise((resolve) => setTimeout(resolve, 16));
  }
  const seen = await frames();
  await mouse.up();
  return seen;
}

/** Counts shapes from now on; the answer ends it. */
async function watch(sheet) {
  const before = await sheet.ask("state");
  const begun = performance.now();
  return async () => {
    const after = await sheet.ask("state");
    const shapes = after.painted - before.painted;
    return {
      shapes,
      seconds: (performance.now() - begun) / 1000,
      takeMs: (after.takenMs - before.takenMs) / Math.max(1, shapes),
    };
  };
}
