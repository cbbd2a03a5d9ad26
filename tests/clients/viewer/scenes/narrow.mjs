/** Small windows: everything is within reach, and nothing lies beside the page. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { nodding } from "../recordings.mjs";
import { openSample } from "./sample.mjs";

/** A telephone, and a desktop's window magnified four times. */
const SIZES = [
  [375, 667],
  [340, 600],
  [320, 256],
];
/** What a finger hits without looking, in CSS pixels. */
const FINGER = 40;
/** Less is of no use to drag in. */
const LEAST_CANVAS = 150;

export const title = "nothing is cut off in small windows";

export async function play({ browser, url, log }) {
  for (const [width, height] of SIZES) {
    const sheet = await Sheet.open(browser, url(), { viewport: { width, height } });
    const fits = async (what) => {
      const seen = await sheet.page.evaluate(() => ({
        wide: Math.max(document.documentElement.scrollWidth, document.body.scrollWidth),
        beside: [...document.querySelectorAll(".topbar .button, .topbar select, .rail .button")]
          .filter((element) => {
            const { left, right } = element.getBoundingClientRect();
            return left < 0 || right > innerWidth;
          })
          .map((element) => element.title || element.ariaLabel),
        under: [...document.querySelectorAll(".rail, .topbar")].filter((bar) => bar.scrollHeight > bar.clientHeight + 1).length,
        canvas: document.querySelector(".canvas").getBoundingClientRect().height,
      }));
      assert.ok(seen.wide <= width, `${what} at ${width} × ${height}: the page is ${seen.wide} wide`);
      assert.deepEqual(seen.beside, [], `${what} at ${width} × ${height}: buttons beside the window`);
      assert.equal(seen.under, 0, `${what} at ${width} × ${height}: bars with something cut off`);
      assert.ok(seen.canvas >= LEAST_CANVAS, `${what} at ${width} × ${height}: the canvas is ${seen.canvas} high`);
      return seen.canvas;
    };
    await fits("the start page");
    await openSample(sheet);
    log(`${width} × ${height}: the canvas is ${Math.round(await fits("the creature"))} high`);
    await sheet.page.getByRole("button", { name: "Export GLB" }).waitFor();
    const small = await sheet.page.evaluate(
      (least) =>
        [...document.querySelectorAll("button, select, summary, input:not([type=checkbox], [type=range])")]
          .filter((element) => element.checkVisibility())
          .map((element) => ({ name: element.title || element.ariaLabel || element.innerText, box: element.getBoundingClientRect() }))
          .filter(({ box }) => box.height > 0 && (box.height < least || box.width < least))
          .map(({ name, box }) => `${name}: ${box.width} × ${box.height}`),
      FINGER,
    );
    assert.deepEqual(small, [], `too small for a finger at ${width} × ${height}`);
    await sheet.picture(`narrow-${width}`);
    await sheet.pick(...nodding(4));
    await sheet.until("an animation is shown", ({ animation }) => animation?.kept === 4);
    await fits("an animation");
    const bar = await sheet.page.locator(".transport").boundingBox();
    const stage = await sheet.page.locator(".stage").boundingBox();
    assert.ok(bar.x >= stage.x && bar.x + bar.width <= stage.x + stage.width, `the bar of an animation at ${width} × ${height} is beside the canvas`);
    assert.ok(bar.height < stage.height / 2, `the bar of an animation at ${width} × ${height} is ${bar.height} high`);
    await sheet.picture(`narrow-animation-${width}`);
    await sheet.key("Escape");
    await sheet.page.getByRole("button", { name: "Help" }).click();
    await sheet.page.getByRole("heading", { name: "How it works" }).waitFor();
    await fits("the help");
    assert.deepEqual(sheet.complaints, []);
    await sheet.close();
  }
  // Who has fingers is told what they do.
  const touched = await Sheet.open(browser, url(), { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true });
  await openSample(touched);
  const hint = await touched.page.getByText("Paint, box or lasso the places").innerText();
  assert.match(hint, /One finger selects; two pan/);
  assert.doesNotMatch(hint, /Shift|button|wheel/);
  // The axes turn the view for a finger, too; a second tap looks from the other side.
  const along = async () => {
    const { eye, target } = await touched.ask("camera");
    const far = Math.hypot(...eye.map((x, k) => x - target[k]));
    return eye.map((x, k) => Math.round((x - target[k]) / far) + 0);
  };
  const side = touched.page.getByRole("button", { name: "View from the right" });
  await side.tap();
  assert.deepEqual(await along(), [1, 0, 0]);
  await touched.page.waitForTimeout(100);
  await side.tap();
  assert.deepEqual(await along(), [-1, 0, 0]);
  await touched.page.getByRole("button", { name: "View from the front" }).tap();
  assert.deepEqual(await along(), [0, 0, 1]);
  await touched.picture("narrow-views");
  await touched.close();
}
