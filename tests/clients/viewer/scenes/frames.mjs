/** Buttons and fields stay in their frames in wide, small and narrow windows, with every panel open. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { openSample } from "./sample.mjs";

export const title = "no button spills out of its frame at 1280, 1024 and 390 pixels";

const SIZES = [
  [1280, 800, "dark"],
  [1024, 768, "light"],
  [390, 844, "dark"],
];

export async function play({ browser, url, log }) {
  for (const [width, height, colorScheme] of SIZES) {
    const sheet = await Sheet.open(browser, url(), { viewport: { width, height }, colorScheme });
    await openSample(sheet);
    await everyPanel(sheet, String(width), log);
    assert.deepEqual(sheet.complaints, []);
    await sheet.close();
  }
}

async function everyPanel(sheet, what, log) {
  const { page } = sheet;
  const closed = page.locator(".inspector details:not([open]) > summary");
  while ((await closed.count()) > 0) await closed.first().click();
  await inFrames(sheet, `${what}, panels open`, log);
  // What only shows when it is asked for.
  await page.getByRole("radio", { name: "Y", exact: true }).click();
  await page.getByRole("button", { name: "Draw a line" }).click();
  await page.getByRole("radio", { name: "a cut" }).click();
  await page.getByLabel("Falloff", { exact: true }).selectOption("LINEAR");
  await page.getByLabel("Falloff radius in model units").waitFor();
  await sheet.until("the handle is changed", ({ busy }) => !busy);
  await inFrames(sheet, `${what}, plane, line and falloff`, log);
  await page.getByText("Line on the surface").scrollIntoViewIfNeeded();
  await sheet.picture(`frames-${what}`);
}

/** Every control of the panels lies inside of what frames it, holds its own words, and covers no other. */
async function inFrames(sheet, what, log) {
  const { seen, spilt } = await sheet.page.evaluate(() => {
    const controls = [...document.querySelectorAll(".inspector :is(button, input, select, output)")].filter((element) => element.checkVisibility());
    const spilt = [];
    const boxes = controls.map((element) => ({ element, name: element.ariaLabel ?? element.innerText ?? element.id, box: element.getBoundingClientRect() }));
    for (const { element, name, box } of boxes) {
      for (let frame = element.parentElement; frame !== null && !frame.matches(".inspector"); frame = frame.parentElement) {
        const { left, right } = frame.getBoundingClientRect();
        if (box.left < left - 1 || box.right > right + 1) spilt.push(`${name} is out of ${frame.tagName.toLowerCase()}.${frame.className}`);
      }
      if (element.scrollWidth > element.clientWidth + 1 && element.matches("button")) spilt.push(`${name} is wider than its button`);
    }
    for (const [k, a] of boxes.entries()) {
      for (const b of boxes.slice(k + 1)) {
        const across = Math.min(a.box.right, b.box.right) - Math.max(a.box.left, b.box.left);
        const down = Math.min(a.box.bottom, b.box.bottom) - Math.max(a.box.top, b.box.top);
        if (across > 1 && down > 1 && !a.element.contains(b.element) && !b.element.contains(a.element)) spilt.push(`${a.name} covers ${b.name}`);
      }
    }
    return { seen: controls.length, spilt };
  });
  log(`${what}: ${seen} controls`);
  assert.ok(seen > 60, `${what}: the panels are open`);
  assert.deepEqual(spilt, [], what);
}
