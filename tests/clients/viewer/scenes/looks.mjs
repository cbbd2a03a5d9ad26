/** What a model looks like: textures, vertex colours, cut-outs; and pictures that cannot be drawn. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { lookingBoxes } from "../gltf.mjs";

/** Vertices of a box; the face towards +z is its last. */
const BOX = 24;
const FRONT = 20;

export const title = "textures, vertex colours and cut-outs are drawn, broken pictures are told";

/** A place on the front face of a box, across from the left and down from the top, 0 to 1. */
async function onFront(sheet, number, across, down) {
  const corners = await Promise.all([0, 1, 2, 3].map((k) => sheet.ask("place", number * BOX + FRONT + k)));
  // Counted from the lower left corner, to the right.
  const [a, b, c, d] = corners;
  const mix = (p, q, share) => ({ x: p.x + (q.x - p.x) * share, y: p.y + (q.y - p.y) * share });
  return mix(mix(d, c, across), mix(a, b, across), down);
}

/** The name of the strongest of red, green and blue, or of a pair. */
function hue([r, g, b]) {
  const most = Math.max(r, g, b);
  if (most - Math.min(r, g, b) < 30) return "grey";
  const strong = (x) => x > most * 0.72;
  return [strong(r) && "r", strong(g) && "g", strong(b) && "b"].filter(Boolean).join("");
}

export async function play({ browser, url }) {
  for (const scheme of ["dark", "light"]) {
    const sheet = await Sheet.open(browser, url(), { colorScheme: scheme });
    await sheet.pick(lookingBoxes());
    await sheet.until("the boxes are dressed", ({ dressed }) => dressed);
    // From the front, so that faces are not hidden by each other.
    const seen = async (places) => (await sheet.colours(await Promise.all(places.map((place) => onFront(sheet, ...place))))).map(hue);
    await sheet.picture(`looks-${scheme}`);
    const quadrants = [[0, 0.25, 0.25], [0, 0.75, 0.25], [0, 0.25, 0.75], [0, 0.75, 0.75]];
    assert.deepEqual(await seen(quadrants), ["r", "g", "b", "rg"], "the four colours of the texture, upright");
    assert.deepEqual(await seen([[1, 0.5, 0.25], [1, 0.5, 0.75]]), ["g", "rg"], "the second set of texture coordinates");
    assert.deepEqual(await seen([[2, 0.5, 0.5]]), ["gb"], "vertex colours");
    assert.deepEqual(await seen([[3, 0.25, 0.5], [3, 0.75, 0.5]]), ["grey", "rb"], "one half of the box is cut out");
    assert.deepEqual(await seen([[4, 0.5, 0.5], [5, 0.5, 0.5], [6, 0.5, 0.5]]), ["r", "g", "b"], "without a picture the plain colour");
    const told = await sheet.page.locator(".warning").allInnerTexts();
    for (const part of ["absent: “nowhere.png” is missing", "image 3 is damaged", "16,384 × 16,384 pixels"]) {
      assert.ok(told.some((line) => line.includes(part)), `${part} is not told: ${told.join(" | ")}`);
    }
    assert.equal((await sheet.ask("state")).faults, 3);

    await sheet.key("u");
    const clay = await seen(quadrants);
    assert.deepEqual(clay, ["grey", "grey", "grey", "grey"], "clay on request");
    await sheet.key("u");
    await sheet.key("k");
    assert.deepEqual(await seen(quadrants), ["grey", "grey", "grey", "grey"], "stretch is read off clay");
    await sheet.key("k");

    // A selection is painted over the texture, and taken off again.
    await sheet.key("c");
    const middle = await onFront(sheet, 0, 0.5, 0.5);
    await sheet.page.mouse.click(middle.x, middle.y);
    await sheet.until("a box is selected", ({ selected }) => selected === BOX);
    assert.deepEqual(await seen([[0, 0.25, 0.75]]), ["r"], "the selection covers the blue quadrant");
    await sheet.key("Escape");
    assert.deepEqual(await seen(quadrants), ["r", "g", "b", "rg"]);

    // After an edit the texture follows the new triangles.
    await sheet.page.locator("summary").getByText("Edit", { exact: true }).click();
    await sheet.page.getByRole("radio", { name: "midpoint" }).click();
    await sheet.page.getByRole("button", { name: "Subdivide", exact: true }).click();
    await sheet.until("the edit is dressed", ({ dressed, vertices }) => dressed && vertices > 8 * BOX);
    const [first] = await sheet.colours([middle]);
    assert.notEqual(hue(first), "grey", "the subdivided box has its texture");
    await sheet.picture(`looks-edited-${scheme}`);
    assert.deepEqual(sheet.complaints, []);
    await sheet.close();
  }
}
