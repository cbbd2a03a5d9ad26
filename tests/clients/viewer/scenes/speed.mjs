/**
 * Large models: shapes painted in a second while dragging, and how long a frame takes from the socket's message until a pixel of its
 * picture is there. Measured, not judged: this browser draws without a card. The larger one is for whoever asks for this scene by
 * name: run speed. SPEED_VERTICES names other sizes.
 */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { finger } from "../models.mjs";
import { asHandles, asPose, compare, holdBothEnds, shows, takeGrip } from "./hold.mjs";

/** How long each model is dragged. */
const DRAG_SECONDS = 4;

export const title = "50 K vertices, and 300 K when asked for, are dragged live";

export async function play({ browser, url, server, log, named }) {
  const usual = named ? [50_000, 300_000] : [50_000];
  for (const vertices of process.env.SPEED_VERTICES?.split(",").map(Number) ?? usual) {
    const sheet = await Sheet.open(browser, url(), { viewport: { width: 1000, height: 640 }, script: timeFrames });
    const model = finger(vertices);
    const begun = performance.now();
    await sheet.pick(model);
    await sheet.until("the model opens", ({ link, busy }) => link === "open" && !busy);
    const opened = performance.now() - begun;
    await holdBothEnds(sheet);
    const frames = await watch(sheet);
    const seen = await dragFor(sheet, DRAG_SECONDS, frames);
    const after = await sheet.until("the release is recorded", ({ revision }) => revision === "4");
    log(
      `${after.vertices} vertices: open ${(opened / 1000).toFixed(1)} s; while dragging ${seen.shapes} shapes in ` +
        `${seen.seconds.toFixed(1)} s = ${(seen.shapes / seen.seconds).toFixed(1)} a second; ` +
        `last solve ${after.solveMs.toFixed(0)} ms; ${after.superseded} poses superseded; ` +
        `page busy ${seen.takeMs.toFixed(1)} ms a shape without drawing`,
    );
    log(await told(sheet));
    const handles = await sheet.ask("handles");
    const session = await server.json("POST", "/v1/sessions?format=ply", model.buffer, "application/octet-stream");
    await server.json("PUT", `/v1/sessions/${session.id}/handles`, { handles: asHandles(handles) });
    const solved = await server.floats("POST", `/v1/sessions/${session.id}/solve`, {
      pose: { handles: [{ id: handles[1].id, pose: asPose(handles[1]) }] },
    });
    // Frames of large models are 16-bit numbers between the corners of their box.
    const { worst, diagonal } = await shows(sheet, solved, compare(solved, solved).diagonal / 65535);
    assert.ok(worst <= diagonal / 65535, `shown and solved differ by ${worst / diagonal} of the box`);
    await server.json("DELETE", `/v1/sessions/${session.id}`).catch(() => undefined);
    await sheet.picture(`finger-${vertices / 1000}k`);
    assert.deepEqual(sheet.complaints, []);
    await sheet.page.getByRole("button", { name: "Close the model" }).click();
    await sheet.page.getByRole("button", { name: "Discard" }).click();
    await sheet.close();
  }
}

/**
 * In the page: when frames come, how long their messages and the painting after them keep it busy, and when a pixel of the picture
 * can be read.
 */
function timeFrames() {
  const kept = { handled: [], painted: [], seen: [] };
  let came;
  const { set, get, ...rest } = Object.getOwnPropertyDescriptor(WebSocket.prototype, "onmessage");
  Object.defineProperty(WebSocket.prototype, "onmessage", {
    ...rest,
    get,
    set(handler) {
      set.call(this, (event) => {
        const begun = performance.now();
        handler.call(this, event);
        if (event.data.byteLength < 10_000) return;
        came ??= begun;
        kept.handled.push(performance.now() - begun);
      });
    },
  });
  const ask = window.requestAnimationFrame.bind(window);
  window.requestAnimationFrame = (paint) =>
    ask((now) => {
      const since = came;
      came = undefined;
      const before = window.pliantViewer?.state().painted;
      const begun = performance.now();
      paint(now);
      if (since === undefined || window.pliantViewer?.state().painted === before) return;
      kept.painted.push(performance.now() - begun);
      const gl = document.querySelector("canvas[role=img]").getContext("webgl2");
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
      kept.seen.push(performance.now() - since);
    });
  window.frameTimes = kept;
}

/** Medians of what `timeFrames` kept. */
async function told(sheet) {
  const kept = await sheet.page.evaluate(() => window.frameTimes);
  const median = (list) => list.toSorted((a, b) => a - b)[list.length >> 1] ?? Number.NaN;
  const [handled, painted, seen] = [kept.handled, kept.painted, kept.seen].map((list) => median(list).toFixed(2));
  return (
    `medians of ${kept.seen.length} frames: ${handled} ms in the handler of a message, ${painted} ms in the painting turn after it, ` +
    `${seen} ms from the message until a pixel of the picture is there`
  );
}

/** Leads the grip around for some seconds; answers what was seen until the mouse let go. */
async function dragFor(sheet, seconds, frames) {
  const { mouse } = sheet.page;
  const grip = await takeGrip(sheet);
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
