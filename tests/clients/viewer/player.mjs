/**
 * The cookbook's page of an animation in a browser: player.mjs FOLDER. Serves the built page, and waits until every frame is there. The
 * server that it talks to is written in it.
 */

import assert from "node:assert/strict";
import { BROWSER, launch, saysWhenAway } from "./browser.mjs";
import { serveFolder } from "./folder.mjs";

const [folder] = process.argv.slice(2);
/** No step takes this long unless something hangs. */
const PATIENCE_MS = 180_000;

if (BROWSER === undefined) {
  console.log("SKIPPED: Chromium is not installed; the page of an animation was not opened");
  process.exit(0);
}

const files = await serveFolder(folder);
const browser = await launch();
try {
  await saysWhenAway(browser, files.url);
  const page = await browser.newPage();
  page.setDefaultTimeout(PATIENCE_MS);
  const complaints = [];
  page.on("pageerror", (error) => complaints.push(String(error)));
  await page.goto(files.url);
  await page.waitForFunction(() => /^\d+ frames, .* a second$/.test(document.querySelector("output").textContent));
  const told = await page.locator("output").textContent();
  assert.ok(Number.parseInt(told, 10) > 5, told);
  // A server that goes in the middle is told as well.
  await page.close();
  const cut = await browser.newPage();
  await cut.route(/\/animations$/, (route) => route.abort("connectionrefused"));
  await cut.goto(files.url);
  await cut.waitForFunction(() => document.querySelector("p").textContent.includes("does not answer"), undefined, { timeout: PATIENCE_MS });
  assert.deepEqual(complaints, []);
  console.log(`the page of an animation: ${told}`);
} finally {
  await browser.close();
  files.stop();
}
