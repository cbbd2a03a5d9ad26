/** The cookbook's page that shows a session's model in a browser: model.mjs FOLDER. Serves the built page, and waits until the model is lit. */

import { onBuiltPage, PATIENCE_MS, places } from "./built_page.mjs";

const [folder] = process.argv.slice(2);

/** Neither black nor the background. */
const LIT = [[40, 235], [40, 235], [40, 235]];

await onBuiltPage(folder, "the page of a model", async ({ page, complaints }) => {
  const deadline = Date.now() + PATIENCE_MS;
  while ((await places(page, LIT)).length < 3000) {
    if (Date.now() > deadline) throw new Error(`no model is shown; the page says ${await page.locator("p").innerText()} ${complaints}`);
  }
  return "the page of a model: shown";
});
