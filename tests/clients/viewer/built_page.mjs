/** A page of a cookbook, built and served from a folder, in a browser. The server that it talks to is written in it. */

import assert from "node:assert/strict";
import { BROWSER, launch, saysWhenAway } from "./browser.mjs";
import { serveFolder } from "./folder.mjs";

/** No step takes this long unless something hangs. */
export const PATIENCE_MS = 180_000;

/**
 * Opens the page of `folder`, once without its server too, and prints what `play` says of it. `what` is the page's name where there is no
 * browser. Nothing may fail in the page unseen.
 */
export async function onBuiltPage(folder, what, play) {
  if (BROWSER === undefined) {
    console.log(`SKIPPED: Chromium is not installed; ${what} was not opened`);
    return;
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
    const said = await play({ browser, page, complaints, url: files.url });
    assert.deepEqual(complaints, []);
    console.log(said);
  } finally {
    await browser.close();
    files.stop();
  }
}
