/** Files that cannot be opened, and what is told about those that can. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";

export const title = "failures leave when something else is opened; a model too large to draw is refused; warnings say a place once";

/** A square of two triangles: open at its rim. */
function square(size) {
  const corners = [[0, 0], [size, 0], [size, size], [0, size]];
  const text = `${corners.map(([x, y]) => `v ${x} ${y} 0\n`).join("")}f 1 2 3\nf 1 3 4\n`;
  return { name: `square-${size}.obj`, mimeType: "model/obj", buffer: Buffer.from(text) };
}

export async function play({ browser, url, server, log }) {
  const sheet = await Sheet.open(browser, url());
  const failures = sheet.page.locator(".notice.error");
  for (let k = 1; k <= 3; k++) {
    await sheet.pick({ name: `broken-${k}.glb`, mimeType: "model/gltf-binary", buffer: Buffer.from("no model") });
    await sheet.page.getByText(`Opening broken-${k}.glb failed`).waitFor();
    assert.equal(await failures.count(), 1, "only the last attempt is told of");
  }

  const before = (await server.json("GET", "/v1/sessions")).sessions?.length ?? 0;
  await sheet.pick(square(1e20));
  await sheet.page.getByText("this page draws up to").waitFor();
  log(await failures.locator("small").innerText());
  let left = Infinity;
  for (const deadline = Date.now() + 30_000; left > before && Date.now() < deadline; ) {
    left = (await server.json("GET", "/v1/sessions")).sessions?.length ?? 0;
  }
  assert.equal(left, before, "its session was closed");

  await sheet.pick(square(1e15));
  await sheet.until("the largest that is drawn opens", ({ link, busy }) => link === "open" && !busy);
  assert.equal(await failures.count(), 0, "what opens takes failures away");
  await sheet.picture("large");

  const warnings = sheet.page.locator(".inspector .warning");
  const texts = await warnings.allInnerTexts();
  assert.ok(texts.length > 0, "a hole is reported");
  for (const text of texts) {
    const places = text.match(/at render vertex [\d,]+/g) ?? [];
    assert.equal(new Set(places).size, places.length, `a place is told twice: ${text}`);
  }
  // A line each, until it is unfolded; and where it is can be shown.
  for (const line of await warnings.all()) assert.ok((await line.boundingBox()).height < 36, `not a line: ${await line.innerText()}`);
  // The pointer tells the whole of what a line cuts off.
  const titles = await sheet.page.locator(".inspector .warning .text").evaluateAll((lines) => lines.map(({ title }) => title));
  assert.ok(titles.some((title) => /hole.* at render vertex [\d,]+ at \(/.test(title)), `titles: ${titles.join(" | ")}`);
  assert.match(texts.join(" | "), /1 hole/);
  const resting = await sheet.ask("place", 0);
  await warnings.getByRole("button", { name: "Show me" }).first().click();
  await sheet.until("the place is pointed at", ({ pointing }) => pointing);
  const shown = await sheet.ask("place", 0);
  assert.ok(Math.hypot(shown.x - resting.x, shown.y - resting.y) > 20, "the camera has gone to the rim");
  await sheet.picture("warning-shown");
  await warnings.getByRole("button", { name: /hole/ }).first().click();
  assert.match(await warnings.first().innerText(), /at render vertex [\d,]+ at \(/);
  // The browser itself writes refused calls to its console.
  assert.deepEqual(sheet.complaints.filter((text) => !/Failed to load resource.*(400|422)/.test(text)), []);
  await sheet.close();
}
