/**
 * The cookbook's page of an animation in a browser: player.mjs FOLDER. Serves the built page, and waits until every frame is there.
 */

import assert from "node:assert/strict";
import { onBuiltPage, PATIENCE_MS } from "./built_page.mjs";

const [folder] = process.argv.slice(2);

await onBuiltPage(folder, "the page of an animation", async ({ browser, page, url }) => {
  await page.waitForFunction(() => /^\d+ frames, .* a second$/.test(document.querySelector("output").textContent));
  const told = await page.locator("output").textContent();
  assert.ok(Number.parseInt(told, 10) > 5, told);
  // A server that goes in the middle is told as well.
  await page.close();
  const cut = await browser.newPage();
  await cut.route(/\/animations$/, (route) => route.abort("connectionrefused"));
  await cut.goto(url);
  await cut.waitForFunction(() => document.querySelector("p").textContent.includes("does not answer"), undefined, { timeout: PATIENCE_MS });
  return `the page of an animation: ${told}`;
});
