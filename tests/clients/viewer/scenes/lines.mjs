/** A line that is clicked onto the surface: it becomes edges, whose vertices are selected, or a cut; keys apply it and drop it. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { shows } from "./hold.mjs";
import { openSample } from "./sample.mjs";

export const title = "lines on the surface are drawn, moved, dropped, inserted as edges and cut along";

export async function play({ browser, url, server, log }) {
  const sheet = await Sheet.open(browser, url());
  await openSample(sheet);
  const { page } = sheet;
  const session = await sheet.ask("session");
  const facts = async () => (await server.json("GET", `/v1/sessions/${session}`)).model;
  const positions = () => server.floats("GET", `/v1/sessions/${session}/positions`);
  const button = (name) => page.getByRole("button", { name, exact: true });
  const line = async () => (await sheet.ask("state")).line;
  const opened = await positions();
  const { triangles: whole } = await facts();
  await sheet.key("1");
  await page.locator("summary").getByText("Edit", { exact: true }).click();
  const draw = () => button("Draw a line").click();
  /** Clicks the surface at places, as shares of the model's outline. */
  const clicks = async (...shares) => {
    const { left, right, top, bottom } = await sheet.outline();
    for (const [across, down] of shares) {
      const before = (await line()).length;
      await page.mouse.click(left + (right - left) * across, top + (bottom - top) * down);
      assert.equal((await line()).length, before + 1, `the point at ${across}, ${down} is on the surface`);
    }
  };
  /** Applies the line by a key; answers how many triangles there are. */
  const apply = async (what, says) => {
    const { revision } = await sheet.ask("state");
    await sheet.key("Enter");
    await sheet.until(`${what} arrives`, (state) => state.revision !== revision && !state.busy);
    await page.locator(".notice", { hasText: says }).last().waitFor();
    assert.equal((await shows(sheet, await positions())).worst, 0, `${what}: what is drawn is what the server holds`);
    assert.deepEqual(await line(), [], `${what}: the line is done`);
    const { triangles } = await facts();
    log(`${what}: ${whole} → ${triangles} triangles`);
    return triangles;
  };

  // Points are clicked, moved and removed; beside the model a click is none, and a drag orbits.
  await draw();
  const { revision } = await sheet.ask("state");
  await clicks([0.3, 0.5], [0.4, 0.52], [0.5, 0.5], [0.6, 0.5], [0.55, 0.5]);
  await sheet.key("Control+z");
  assert.equal((await line()).length, 4, "Ctrl+Z takes the last point back");
  await button("Remove last").click();
  const { left, top } = await sheet.outline();
  await page.mouse.click(left, top);
  assert.equal((await line()).length, 3, "there is no surface at the outline's corner");
  const [, second] = await line();
  await sheet.drag([second, { x: second.x, y: second.y + 15 }]);
  const [, moved] = await line();
  assert.ok(Math.abs(moved.x - second.x) < 2 && Math.abs(moved.y - second.y - 15) < 2, `the point is moved: ${JSON.stringify([second, moved])}`);
  await sheet.picture("line-edges");
  await sheet.key("Backspace");
  assert.equal((await line()).length, 2, "Backspace removes the last point");
  const { eye } = await sheet.ask("camera");
  await sheet.drag([{ x: left, y: top }, { x: left + 60, y: top }]);
  assert.notDeepEqual((await sheet.ask("camera")).eye, eye, "a drag orbits");
  await sheet.key("Escape");
  assert.deepEqual(await line(), [], "Escape drops the line");
  assert.equal((await sheet.ask("state")).revision, revision, "and nothing is recorded");

  // Edges: their vertices are selected, and Enter makes a handle of them.
  await sheet.key("1");
  await draw();
  assert.ok(await button("Make edges").isDisabled(), "a line without points is none");
  await clicks([0.3, 0.5], [0.5, 0.5]);
  assert.ok((await apply("a line of edges", "Inserting a line: done")) > whole, "triangles are split along it");
  const { selected } = await sheet.until("its vertices are selected", (state) => state.selected > 2);
  await sheet.picture("line-selected");
  await sheet.key("Enter");
  await page.waitForFunction(() => window.pliantViewer.handles().length === 3);
  assert.equal((await sheet.ask("handles"))[2].vertices.length, selected);
  for (let k = 0; k < 8 && (await facts()).triangles !== whole; k++) await sheet.undo();
  assert.deepEqual(await positions(), opened);

  // A cut: a closed line takes a patch out, or leaves it alone.
  await draw();
  await page.getByRole("radio", { name: "a cut" }).click();
  await page.getByLabel("Closed line").check();
  await page.getByLabel("Close the cut").last().uncheck();
  const patch = [[0.3, 0.46], [0.45, 0.46], [0.45, 0.54], [0.3, 0.54]];
  await clicks(...patch);
  await sheet.picture("line-cut");
  await page.getByRole("radio", { name: "left", exact: true }).click();
  const around = await apply("keeping the left", "Cutting: done");
  await sheet.undo();
  await draw();
  await clicks(...patch);
  await page.getByRole("radio", { name: "right", exact: true }).click();
  const within = await apply("keeping the right", "Cutting: done");
  await sheet.picture("line-cut-done");
  assert.ok(within < whole / 20 && around > whole * 0.95, `the line goes clockwise: ${within} triangles lie to its right, ${around} to its left`);
  await sheet.undo();
  assert.deepEqual(await positions(), opened);

  // What the server refuses leaves the line as it is.
  await draw();
  await page.getByLabel("Closed line").uncheck();
  await clicks([0.3, 0.5], [0.5, 0.5]);
  const errors = sheet.complaints.length;
  await sheet.key("Enter");
  await page.getByText("Cutting failed").waitFor();
  assert.equal((await line()).length, 2, "the line can be mended");
  sheet.complaints = sheet.complaints.filter((text, k) => k < errors || !/Failed to load resource/.test(text));
  assert.deepEqual(sheet.complaints, []);
  await sheet.close();
}
