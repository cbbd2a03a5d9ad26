/** A page of a cookbook, built and served from a folder, in a browser. It talks to the server that PLIANT_SERVER names, or to the one written in it. */

import assert from "node:assert/strict";
import { BROWSER, launch, saysWhenAway } from "./browser.mjs";
import { serveFolder } from "./folder.mjs";

/** No step takes this long unless something hangs. */
export const PATIENCE_MS = 180_000;

/** Where pixels of a page's canvas are of a colour: three ranges. */
export async function places(page, ranges) {
  const shot = (await page.locator("canvas").screenshot()).toString("base64");
  return page.evaluate(
    async ([text, wanted]) => {
      const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
      const bitmap = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
      const paint = new OffscreenCanvas(bitmap.width, bitmap.height).getContext("2d");
      paint.drawImage(bitmap, 0, 0);
      const { data } = paint.getImageData(0, 0, bitmap.width, bitmap.height);
      const found = [];
      for (let k = 0; k < data.length; k += 4) {
        const fits = wanted.every(([low, high], c) => data[k + c] >= low && data[k + c] <= high);
        if (fits) found.push({ x: (k / 4) % bitmap.width, y: Math.floor(k / 4 / bitmap.width) });
      }
      return found;
    },
    [shot, ranges],
  );
}

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
    const server = process.env.PLIANT_SERVER;
    const url = server === undefined ? files.url : `${files.url}?server=${encodeURIComponent(server)}`;
    await page.goto(url);
    const said = await play({ browser, page, complaints, url });
    assert.deepEqual(complaints, []);
    console.log(said);
  } finally {
    await browser.close();
    files.stop();
  }
}
