/** Failures are told to somebody who has a page in front of them, and of what nobody waits for any more nothing is told. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { finger } from "../models.mjs";
import { waving } from "../recordings.mjs";

export const title = "failures speak of files to drop, not of flags; a clip that another model overtakes is not told of";

export async function play({ browser, url, server, log }) {
  const sheet = await Sheet.open(browser, url());
  const { page } = sheet;
  const failure = page.locator(".notice.error small");

  const alone = { asset: { version: "2.0" }, buffers: [{ uri: "Avocado.bin", byteLength: 4 }] };
  await sheet.drop({ name: "Avocado.gltf", mimeType: "model/gltf+json", buffer: Buffer.from(JSON.stringify(alone)) });
  await failure.waitFor();
  const missing = await failure.innerText();
  log(missing);
  assert.match(missing, /"Avocado\.bin" is missing; drop the model together with Avocado\.bin, or drop the folder/);
  assert.doesNotMatch(missing, /multipart|command line/);

  await sheet.drop(finger(600));
  await sheet.until("the finger opens", ({ link, busy }) => link === "open" && !busy);
  await sheet.drop(waving(3));
  await failure.waitFor();
  const unlike = await failure.innerText();
  log(unlike);
  assert.match(unlike, /joints are not sure.*scores below 0\.5.*; drop a rig/s);
  assert.doesNotMatch(unlike, /--|NAME=|pliant rig/);

  // The figure's clip is still being read when another model is dropped.
  const figure = Buffer.from(await (await fetch(`${server.url}/v1/sample.glb?name=figure`)).arrayBuffer());
  await sheet.drop({ name: "figure.glb", mimeType: "model/gltf-binary", buffer: figure });
  await sheet.until("the figure opens", ({ link, busy, dressed, vertices }) => link === "open" && !busy && dressed && vertices > 5000);
  const before = await sheet.ask("session");
  let asked;
  const reached = new Promise((resolve) => (asked = resolve));
  let release;
  const held = new Promise((resolve) => (release = resolve));
  await page.route("**/animations", async (route) => {
    asked();
    await held;
    await route.continue().catch(() => undefined);
  });
  await sheet.drop(waving(3));
  await reached;
  await sheet.drop(finger(600));
  await page.waitForFunction((id) => ![undefined, id].includes(window.pliantViewer.session()), before);
  await sheet.until("the finger opens", ({ link, busy }) => link === "open" && !busy);
  for (const deadline = Date.now() + 30_000; (await fetch(`${server.url}/v1/sessions/${before}`)).ok && Date.now() < deadline; );
  release();
  // What the server answers to the overtaken call has come when one that is asked later is answered.
  await page.evaluate(() => fetch("/v1/limits").then((answer) => answer.text()));
  await page.waitForTimeout(300);
  assert.deepEqual(await page.locator(".notice.error").allInnerTexts(), []);
  assert.deepEqual(sheet.complaints.filter((text) => !/Failed to load resource.*4\d\d/.test(text)), []);
  await sheet.close();
}
