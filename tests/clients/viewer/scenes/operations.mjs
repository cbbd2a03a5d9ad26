/** Every edit that the panel offers, one after the other: what is drawn is what the server holds, and undo leads back. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { shows } from "./hold.mjs";
import { openSample } from "./sample.mjs";

export const title = "delete, fill, decimate, weld, clean, merge, wrap, resolve crossings and adopt are in the panel; what changes nothing says so";

const TETRAHEDRON = "v 3 0 0\nv 3.5 0 0\nv 3 0.5 0\nv 3 0 0.5\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n";

export async function play({ browser, url, server, log }) {
  const sheet = await Sheet.open(browser, url());
  await openSample(sheet);
  const session = await sheet.ask("session");
  const facts = async () => (await server.json("GET", `/v1/sessions/${session}`)).model;
  const positions = () => server.floats("GET", `/v1/sessions/${session}/positions`);
  const { page } = sheet;
  await page.locator("summary").getByText("Edit", { exact: true }).click();
  const button = (name) => page.getByRole("button", { name, exact: true });
  const opened = await positions();
  let steps = 0;
  /** Carries an edit out; answers how many triangles there are, and what the page says. */
  const edit = async (name, says, act = () => button(name).click()) => {
    const { revision } = await sheet.ask("state");
    await act();
    await sheet.until(`${name} arrives`, (state) => state.revision !== revision && !state.busy);
    steps += 1;
    const note = page.locator(".notice", { hasText: says }).last();
    await note.waitFor();
    assert.equal((await shows(sheet, await positions())).worst, 0, `${name}: what is drawn is what the server holds`);
    const { triangles } = await facts();
    log(`${name}: ${triangles} triangles; ${(await note.innerText()).replace(/\s+/g, " ")}`);
    return triangles;
  };
  const choose = async (name, act, file) => {
    const chooser = new Promise((resolve) => sheet.choosing.push(resolve));
    await button(name).click();
    await (await chooser).setFiles(file);
    await act?.();
  };
  const { triangles: whole } = await facts();

  assert.equal(await edit("Weld", "Welding changed nothing"), whole);
  await page.locator(".history").getByText("Welding: nothing changed").waitFor();

  assert.ok(await button("Delete selection").isDisabled(), "what is not selected cannot be deleted");
  const [, head] = await sheet.ask("handles");
  await sheet.key("x");
  await sheet.drag([{ x: head.at.x + 60, y: head.at.y - 150 }, { x: head.at.x + 260, y: head.at.y + 40 }]);
  await sheet.until("the box selects", ({ selected }) => selected > 0);
  const open = await edit("Delete selection", "Deleting: done");
  assert.ok(open < whole, `${open} of ${whole} triangles are left`);
  await sheet.picture("edit-panel");
  assert.ok((await edit("Fill holes", "Filling holes: done")) > open, "the hole is closed");
  const before = (await facts()).triangles;
  const fewer = await edit("Decimate", "Decimating: done");
  assert.ok(fewer < before * 0.6 && fewer > before * 0.4, `half of ${before} are ${fewer}`);

  // A small part, and a copy of it, go by each rule.
  const merge = () => edit("Merge", "Merging: done", () => choose("Merge…", undefined, { name: "tetrahedron.obj", mimeType: "text/plain", buffer: Buffer.from(TETRAHEDRON) }));
  const rule = async (name, value) => {
    await page.getByLabel(name, { exact: true }).fill(String(value));
    await sheet.key("Enter");
  };
  await rule("Smallest area of a part", 0);
  assert.ok(await button("Clean").isDisabled(), "without a rule there is nothing to clean");
  for (const [name, value] of [["Smallest area of a part", 50], ["Smallest size of a part", 1], ["Parts to keep", 1]]) {
    assert.equal(await merge(), fewer + 4);
    await rule(name, value);
    assert.equal(await edit("Clean", "Cleaning: done"), fewer, `${name}: ${value}`);
    await rule(name, 0);
  }
  for (let copies = 0; copies < 2; copies++) await merge();
  await rule("Distance of copies", 0.001);
  await sheet.picture("edit-clean");
  assert.equal(await edit("Clean", "Cleaning: done"), fewer + 4, "one of the copies stays");
  await rule("Distance of copies", 0);
  await rule("Parts to keep", 1);
  assert.equal(await edit("Clean", "Cleaning: done"), fewer);
  assert.equal(await edit("Resolve crossings", "Resolving crossings"), fewer);

  // A pose becomes the rest pose: the handle is at rest there.
  await sheet.tool("Move the handle");
  const { revision } = await sheet.ask("state");
  for (const key of ["g", "y", "0", ".", "1", "Enter"]) await sheet.key(key);
  await sheet.until("the pose is recorded", (state) => state.revision !== revision);
  steps += 1;
  const posed = await positions();
  await edit("Set as rest pose", "New rest pose: done");
  assert.deepEqual(await positions(), posed, "the shape stays");
  const [, adopted] = await sheet.ask("handles");
  assert.ok(adopted.pose.translation.every((x) => x === 0), "and its handles are at rest");

  const target = Buffer.from(await (await fetch(`${server.url}/v1/sessions/${session}/model?format=obj`)).arrayBuffer());
  await edit("Wrap onto", "Wrapping: done", () => choose("Wrap onto…", undefined, { name: "scan.obj", mimeType: "text/plain", buffer: target }));

  // The box was a step, too, and so was the tool's choice of a handle.
  const first = (await server.json("GET", `/v1/sessions/${session}/history`)).commits[1].revision;
  for (let k = 0; k < steps + 4 && (await sheet.ask("state")).revision !== first; k++) {
    await sheet.undo();
  }
  assert.deepEqual(await positions(), opened, "undo leads back across all of it");
  assert.deepEqual(sheet.complaints, []);
  await sheet.close();
}
