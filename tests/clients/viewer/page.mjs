/**
 * The cookbook's page in a browser: page.mjs FOLDER. Serves the built page, drags over its picture, and says what the page
 * says. The server that it talks to is written in it.
 */

import { onBuiltPage } from "./built_page.mjs";

const [folder] = process.argv.slice(2);

await onBuiltPage(folder, "the page", async ({ page }) => {
  await page.waitForFunction(() => {
    const canvas = document.querySelector("canvas");
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    return data.some((x) => x > 0);
  });
  const picture = () => page.locator("canvas").evaluate((canvas) => canvas.toDataURL());
  const before = await picture();
  const { x, y } = await page.locator("canvas").boundingBox();
  await page.mouse.move(x + 457, y + 132);
  await page.mouse.down();
  for (let k = 1; k <= 20; k++) await page.mouse.move(x + 457 + 2 * k, y + 132 - 2 * k);
  await page.mouse.up();
  await page.waitForFunction(() => document.title === "Revision 3");
  await page.waitForFunction((was) => document.querySelector("canvas").toDataURL() !== was, before);
  return `dragged; the page says: ${await page.locator("p").innerText()}`;
});
