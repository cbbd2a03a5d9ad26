/**
 * The cookbook's page with three.js in a browser: grip.mjs FOLDER [PICTURE]. Serves the built page, pulls the green arrow up, and then turns by a
 * ring.
 */

import { onBuiltPage, PATIENCE_MS, places } from "./built_page.mjs";

const [folder, picture] = process.argv.slice(2);

const GREEN = [[0, 90], [200, 255], [0, 90]];
const CREATURE = [[60, 175], [70, 190], [110, 255]];
const top = (found) => found.reduce((a, b) => (b.y < a.y ? b : a), { y: Infinity });

await onBuiltPage(folder, "the page", async ({ page, complaints }) => {
  const deadline = Date.now() + PATIENCE_MS;
  let arrow = [];
  while (arrow.length < 20) {
    if (Date.now() > deadline) throw new Error(`no arrow is drawn; the page says ${await page.locator("p").innerText()} ${complaints}`);
    arrow = await places(page, GREEN);
  }
  const { x, y } = await page.locator("canvas").boundingBox();
  const high = top(await places(page, CREATURE)).y;
  const tip = top(arrow);
  const hand = { x: x + tip.x, y: y + tip.y + 5 };
  await page.mouse.move(hand.x, hand.y);
  await page.mouse.down();
  for (let k = 1; k <= 20; k++) await page.mouse.move(hand.x, hand.y - 2 * k);
  await page.mouse.up();
  await page.waitForFunction(() => document.title === "Revision 3");
  while (top(await places(page, CREATURE)).y > high - 15) {
    if (Date.now() > deadline) throw new Error("the head does not follow the arrow");
  }
  if (picture) await page.locator("canvas").screenshot({ path: picture });
  // Turned by the ring of the same axis, which is where its green is leftmost.
  await page.keyboard.press("e");
  await page.waitForTimeout(300);
  const ring = (await places(page, GREEN)).reduce((a, b) => (b.y > a.y ? b : a));
  await page.mouse.move(x + ring.x, y + ring.y);
  await page.mouse.down();
  for (let k = 1; k <= 20; k++) await page.mouse.move(x + ring.x + 3 * k, y + ring.y);
  await page.mouse.up();
  await page.waitForFunction(() => document.title === "Revision 4");
  return "pulled by an arrow and turned by a ring";
});
