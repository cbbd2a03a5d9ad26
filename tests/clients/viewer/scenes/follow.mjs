/** The camera goes with a figure that walks, while a recording plays and frame by frame, and is left where it is otherwise. */

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { Sheet } from "../browser.mjs";
import { bodyAlone } from "../models.mjs";
import { waving } from "../recordings.mjs";
import { BINARY } from "../server.mjs";

export const title = "the camera follows a walking figure when asked to";

const FRAMES = 24;
/** Pixels that the middle of the figure may be off: it is drawn in perspective, and arms swing. */
const STILL = 12;

export async function play({ browser, url, log }) {
  const folder = mkdtempSync(path.join(tmpdir(), "pliant-viewer-"));
  try {
    const file = path.join(folder, "figure.glb");
    execFileSync(BINARY, ["sample", "figure", "-o", file], { stdio: "pipe" });
    await walk(await Sheet.open(browser, url()), bodyAlone(readFileSync(file)), log);
  } finally {
    rmSync(folder, { recursive: true });
  }
}

/** The frame, where the middle of the figure is in the model's space and on the page, and the camera. */
function now(sheet) {
  return sheet.page.evaluate(() => {
    const probe = window.pliantViewer;
    const positions = probe.positions();
    const count = positions.length / 3;
    const [middle, place] = [[0, 0, 0], { x: 0, y: 0 }];
    for (let v = 0; v < count; v++) {
      const { x, y } = probe.place(v) ?? { x: NaN, y: NaN };
      place.x += x / count;
      place.y += y / count;
      for (let k = 0; k < 3; k++) middle[k] += positions[v * 3 + k] / count;
    }
    return { at: probe.state().animation?.at, middle, place, camera: probe.camera() };
  });
}

async function walk(sheet, model, log) {
  const { page } = sheet;
  await sheet.pick({ name: "figure.glb", mimeType: "model/gltf-binary", buffer: model });
  await sheet.until("the figure is open", ({ clips, busy, link }) => clips > 0 && !busy && link === "open");
  const follow = page.getByRole("button", { name: "Camera follows the model" });
  assert.equal(await follow.count(), 0, "nothing walks yet");
  await sheet.drop(waving(FRAMES, "walking.bvh", 4));
  await sheet.until("all frames are there", ({ animation }) => animation?.kept === FRAMES && !animation.coming);
  const frame = async (at) => {
    await page.getByLabel("Frame", { exact: true }).evaluate((input, value) => {
      input.value = String(value);
      input.dispatchEvent(new Event("input", { bubbles: true }));
    }, at);
    await sheet.until(`frame ${at}`, ({ animation }) => animation.at === at && !animation.running);
    return now(sheet);
  };
  const [first, last] = [await frame(0), await frame(FRAMES - 1)];
  assert.deepEqual(last.camera, first.camera, "it stays where it is unless asked");
  const way = Math.abs(last.place.x - first.place.x);
  assert.ok(way > 10 * STILL, `the figure walks over ${way} pixels`);

  await follow.click();
  assert.equal(await follow.getAttribute("aria-pressed"), "true");
  const { place } = await now(sheet);
  const stage = await page.locator(".stage").boundingBox();
  assert.ok(place.x > stage.x + stage.width / 4 && place.x < stage.x + stage.width * 0.75, `it is in the middle at once: ${place.x}`);
  const begun = await frame(0);
  for (const at of [5, 11, 17, FRAMES - 1]) {
    const seen = await frame(at);
    for (const axis of [0, 2]) {
      const [walked, went] = [seen.middle[axis] - begun.middle[axis], seen.camera.target[axis] - begun.camera.target[axis]];
      assert.ok(Math.abs(walked - went) < 1e-4, `frame ${at}: it went ${walked} along axis ${axis}, the camera ${went}`);
    }
    assert.ok(Math.abs(seen.place.x - begun.place.x) < STILL, `frame ${at}: it is drawn at ${seen.place.x}, it was at ${begun.place.x}`);
  }
  await sheet.picture("follow");

  // While it plays, and from its end to its beginning.
  await frame(0);
  await page.getByRole("button", { name: "Play the animation" }).click();
  const played = new Map();
  await sheet.until("it plays", ({ animation }) => animation.running);
  for (let look = 0; played.size < 8; look++) {
    assert.ok(look < 1000, `it plays ${played.size} frames only`);
    const seen = await now(sheet);
    played.set(seen.at, seen.place.x);
  }
  const off = Math.max(...[...played.values()].map((x) => Math.abs(x - begun.place.x)));
  assert.ok(off < STILL, `while it plays it is off by ${off} pixels: ${JSON.stringify([...played])}`);
  log(`on its own it walks over ${way.toFixed(0)} pixels; followed, it is off by ${off.toFixed(1)} in ${played.size} frames that were seen playing`);

  // Not asked any more, it stays; asked again, it goes back with the pose.
  await follow.click();
  const { camera } = await frame(FRAMES - 1);
  assert.deepEqual((await frame(2)).camera, camera);
  await follow.click();
  await frame(FRAMES - 1);
  await sheet.key("Escape");
  await sheet.until("the pose is back", ({ animation }) => animation === null);
  const back = await now(sheet);
  assert.ok(back.place.x > stage.x && back.place.x < stage.x + stage.width, `the pose is in the picture: ${back.place.x}`);
  assert.deepEqual(sheet.complaints, []);
  await sheet.close();
}
