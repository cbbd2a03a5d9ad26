/** Clips of the model and recordings, solved by the server: frames come, are kept, stepped through, compared, and leave no trace. */

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { Sheet } from "../browser.mjs";
import { bodyAlone } from "../models.mjs";
import { nodding, waving } from "../recordings.mjs";
import { BINARY } from "../server.mjs";
import { openSample } from "./sample.mjs";

export const title = "clips and recordings move the model frame by frame, beside linear blend skinning, and leave no trace";

const farthest = (a, b) => a.reduce((most, x, k) => Math.max(most, Math.abs(x - b[k])), Math.abs(a.length - b.length));

/** Goes to a frame; answers what is drawn. */
async function frame(sheet, at) {
  await sheet.page.getByLabel("Frame", { exact: true }).evaluate((input, value) => {
    input.value = String(value);
    input.dispatchEvent(new Event("input", { bubbles: true }));
  }, at);
  return sheet.positions();
}

const beside = async (sheet) => new Float32Array(await sheet.page.evaluate(() => [...window.pliantViewer.beside()]));
const complete = (sheet) => sheet.until("all frames are there", ({ animation }) => animation !== null && animation.kept === animation.wanted && !animation.coming);

/** What `pliant animate` writes of the same clip: the positions of a frame. */
function cacheOf(folder, ...given) {
  const file = path.join(folder, "frames.pc2");
  execFileSync(BINARY, ["animate", ...given, "-o", file, "--force"], { stdio: "pipe" });
  const bytes = readFileSync(file);
  const vertices = bytes.readInt32LE(16);
  const frames = bytes.readInt32LE(28);
  return { frames, of: (k) => new Float32Array(bytes.buffer.slice(bytes.byteOffset + 32 + k * vertices * 12, bytes.byteOffset + 32 + (k + 1) * vertices * 12)) };
}

export async function play({ browser, url, server, log }) {
  const folder = mkdtempSync(path.join(tmpdir(), "pliant-viewer-"));
  try {
    await ownClip({ browser, url, server, log, folder });
    await recordings({ browser, url, folder });
    await refusals({ browser, url });
  } finally {
    rmSync(folder, { recursive: true });
  }
}

/** The figure's own walk. */
async function ownClip({ browser, url, server, log, folder }) {
  const model = path.join(folder, "figure.glb");
  execFileSync(BINARY, ["sample", "figure", "-o", model], { stdio: "pipe" });
  const sheet = await Sheet.open(browser, url());
  await sheet.pick({ name: "figure.glb", mimeType: "model/gltf-binary", buffer: readFileSync(model) });
  await sheet.until("the figure is open", ({ clips, busy, link }) => clips > 0 && !busy && link === "open");
  const rest = await sheet.positions();
  const id = await sheet.ask("session");
  const before = await server.json("GET", `/v1/sessions/${id}/history`);

  await sheet.page.locator("summary", { hasText: "Animation" }).click();
  await sheet.page.getByRole("button", { name: "Animate" }).click();
  await sheet.until("it plays while frames come", ({ animation }) => animation !== null && animation.at > 0);
  const { animation } = await complete(sheet);
  const frames = animation.kept;
  assert.ok(frames > 20, `the walk has ${frames} frames`);
  await sheet.until("a skin is shown beside it", (state) => state.animation.compared);
  const at = Math.floor(frames / 3);
  const solved = await frame(sheet, at);
  assert.ok(farthest(solved, rest) > 0.05, "it moves");
  const blended = await beside(sheet);
  // What no skin places stays where it is in the left half.
  const skinned = rest.map((_, k) => k).filter((k) => blended[k] !== rest[k]);
  const [left, right, still] = [blended, solved, rest].map((list) => Array.from(skinned, (k) => list[k]));
  log(`at frame ${at} linear blend skinning is ${farthest(left, still).toFixed(3)} from rest and ${farthest(left, right).toFixed(3)} from the solved frame`);
  assert.ok(farthest(left, right) < 0.3 * farthest(left, still), "both are of the same moment");
  assert.ok(farthest(left, right) > 1e-3, "they are two ways");
  await sheet.picture("animate-beside");
  await sheet.key("ArrowRight");
  await sheet.until("a frame on", (state) => state.animation.at === at + 1 && !state.animation.running);
  await sheet.key("ArrowLeft");
  assert.deepEqual(await sheet.positions(), solved);
  assert.match(await sheet.page.locator(".transport output").innerText(), new RegExp(`^${at + 1} of ${frames} · \\d+\\.\\d\\d s$`));

  await sheet.key("k");
  await sheet.picture("animate-stretch");
  await sheet.key("k");
  await sheet.page.getByRole("button", { name: "Linear blend skinning beside it" }).click();
  await sheet.until("alone", (state) => !state.animation.compared);
  assert.equal(await sheet.page.evaluate(() => window.pliantViewer.beside()), undefined);
  await sheet.page.getByRole("button", { name: "Play the animation" }).click();
  await sheet.until("it plays", (state) => state.animation.running && state.animation.at !== at);
  await sheet.key("Escape");
  await sheet.until("back to the pose", (state) => state.animation === null);
  assert.deepEqual(await sheet.positions(), rest);
  // The blend is what the clip itself plays.
  await sheet.key("Space");
  await sheet.until("the clip runs", ({ seconds }) => seconds >= 0);
  await sheet.page.getByLabel("Time in the clip").evaluate((input, value) => {
    input.step = "any";
    input.value = String(value);
    input.dispatchEvent(new Event("input", { bubbles: true }));
  }, at / 30);
  assert.ok(farthest(await sheet.positions(), blended) < 1e-4, "the left half was the clip at this moment");
  await sheet.key("Escape");
  const { revision } = await server.json("GET", `/v1/sessions/${id}`);
  const after = await server.json("GET", `/v1/sessions/${id}/history`);
  assert.deepEqual(after, before, "the history is as it was");
  assert.equal(String(revision), String((await sheet.ask("state")).revision));

  // Bent by somebody else meanwhile: the blend is still that of the model at rest, as the frames are.
  const head = { id: "head", region: { box: { min: [-9, 1.5, -9], max: [9, 9, 9] } } };
  const feet = { id: "feet", region: { box: { min: [-9, -9, -9], max: [9, 0.2, 9] } } };
  await server.json("PUT", `/v1/sessions/${id}/handles`, { handles: [head, feet] });
  await server.floats("POST", `/v1/sessions/${id}/solve`, { pose: { handles: [{ id: "head", pose: { translation: [0.3, 0.1, 0] } }] } });
  // The page looks at its session when it gets the focus, and what it learns would end an animation that is on.
  await sheet.page.evaluate(() => dispatchEvent(new Event("focus")));
  await sheet.until("the page has learnt of it", (state) => state.revision === "3" && !state.busy);
  await sheet.page.getByRole("button", { name: "Animate" }).click();
  await complete(sheet);
  assert.deepEqual(await frame(sheet, at), solved, "the same frames come");
  await sheet.page.getByRole("button", { name: "Linear blend skinning beside it" }).click();
  await sheet.until("the skin is shown again", (state) => state.animation.compared);
  assert.ok(farthest(await beside(sheet), blended) < 1e-6, "of the model at rest");
  assert.deepEqual(sheet.complaints, []);
  await sheet.close();
  // Taken up where the file is not at hand there is nothing to compare with.
  const other = await Sheet.open(browser, `${url()}/?session=${id}`);
  await other.until("the bent figure is open", ({ clips, busy, link }) => clips > 0 && !busy && link === "open");
  const bent = await other.positions();
  assert.ok(farthest(bent, rest) > 0.2);
  await other.page.locator("summary", { hasText: "Animation" }).click();
  await other.page.getByRole("button", { name: "Animate" }).click();
  await complete(other);
  await other.page.waitForLoadState("networkidle");
  assert.equal((await other.ask("state")).animation.compared, false);
  assert.deepEqual(await frame(other, at), solved);
  await other.key("Escape");
  assert.deepEqual(await other.positions(), bent, "it is bent as before");
  assert.deepEqual(other.complaints, []);
  await other.close();
}

/** Recordings: on a figure without a rig, on the creature with one; cancelled and gone on with. */
async function recordings({ browser, url, folder }) {
  const sheet = await Sheet.open(browser, url());
  const figure = bodyAlone(readFileSync(path.join(folder, "figure.glb")));
  writeFileSync(path.join(folder, "bare.glb"), figure);
  await sheet.pick({ name: "bare.glb", mimeType: "model/gltf-binary", buffer: figure });
  await sheet.until("the figure is open", ({ clips, busy, link }) => clips > 0 && !busy && link === "open");
  const clip = waving(12);
  await sheet.drop(clip);
  const { animation } = await complete(sheet);
  assert.deepEqual([animation.kept, animation.compared], [12, false]);
  await frame(sheet, 11);
  const gone = await sheet.positions();
  await sheet.picture("animate-recording");
  const [model, bvh, rig] = ["bare.glb", "waving.bvh", "rig.json"].map((name) => path.join(folder, name));
  writeFileSync(bvh, clip.buffer);
  execFileSync(BINARY, ["rig", model, "--bvh", bvh, "-o", rig, "--no-picture"], { stdio: "pipe" });
  const cache = cacheOf(folder, model, "--bvh", bvh, "--rig", rig);
  assert.equal(cache.frames, 12);
  assert.ok(farthest(gone, cache.of(11)) < 2e-6, "it is what pliant rig and pliant animate make of them");
  await sheet.page.getByRole("button", { name: "Root motion" }).click();
  const stayed = await sheet.positions();
  assert.ok(farthest(gone, stayed) > 0.02, "in its place it is elsewhere");

  // Many frames: cancelled on the way, what came stays and more can be had.
  await sheet.drop(waving(2000, "long.bvh"));
  await sheet.until("some frames", (state) => state.animation?.wanted === 2000 && state.animation.kept >= 3);
  await sheet.page.getByText(/frame \d+ of 2\D?000, .* frames\/s, \d+ (s|min) left/).waitFor();
  await sheet.picture("animate-coming");
  await sheet.page.getByRole("button", { name: "Cancel" }).click();
  const held = (await sheet.until("cancelled", (state) => !state.animation.coming)).animation;
  assert.ok(held.kept < 2000);
  await frame(sheet, held.kept - 1);
  await sheet.page.getByRole("button", { name: "Resume" }).click();
  await sheet.until("more frames", (state) => state.animation.kept > held.kept);

  // A recording that is none: one line, and what is shown stays.
  await sheet.page.getByRole("button", { name: "Cancel" }).click();
  const kept = (await sheet.until("cancelled", (state) => !state.animation.coming)).animation.kept;
  const bad = waving(5, "bad.bvh");
  await sheet.drop({ ...bad, buffer: Buffer.from(String(bad.buffer).replace("Frame Time: 0.0333333", "Frame Time: soon")) });
  const line = sheet.page.locator(".notice.error small");
  await line.waitFor();
  assert.match(await line.innerText(), /line \d+/);
  assert.equal((await sheet.ask("state")).animation.kept, kept, "nothing is lost");
  await sheet.key("x");
  await sheet.until("another tool ends it", (state) => state.animation === null);
  assert.deepEqual(sheet.complaints.filter((text) => !/Failed to load resource.*4\d\d/.test(text)), []);
  await sheet.close();

  const other = await Sheet.open(browser, url());
  await openSample(other);
  const rest = await other.positions();
  await other.pick(...nodding(8));
  assert.equal((await complete(other)).animation.kept, 8);
  assert.ok(farthest(await frame(other, 6), rest) > 0.05, "the creature nods");
  await other.key("Escape");
  assert.deepEqual(await other.positions(), rest);
  assert.deepEqual(other.complaints, []);
  await other.close();
}

/** What cannot be played, and what does not fit. */
async function refusals({ browser, url }) {
  const sheet = await Sheet.open(browser, url());
  await sheet.drop(waving(3));
  await sheet.page.getByText("No model is open").waitFor();
  await openSample(sheet);
  await sheet.drop(waving(3));
  await sheet.page.getByText("a rig is needed").waitFor();
  assert.equal((await sheet.ask("state")).animation, null);
  // Half a gigabyte is kept, and no more: fewer frames are offered.
  const [clip, rig] = nodding(50_000);
  await sheet.pick(clip, rig);
  await sheet.page.getByText(/50\D?000 frames of nodding.bvh take .* GiB/).waitFor();
  await sheet.picture("animate-too-long");
  await sheet.page.getByRole("button", { name: /^One frame of \d+/ }).click();
  const { animation } = await sheet.until("fewer frames come", (state) => state.animation !== null && state.animation.kept > 1);
  assert.ok(animation.wanted < 50_000);
  await sheet.key("Escape");
  await sheet.until("closed", (state) => state.animation === null);
  await sheet.close();
}
