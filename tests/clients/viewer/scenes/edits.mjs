/** Edits from the panel, where the server has them: the page shows the new topology, drags it, and undo brings the old one back. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { compare, dragGrip } from "./hold.mjs";
import { openSample } from "./sample.mjs";

export const title = "subdividing and cutting change what is drawn";

export async function play({ browser, url, server, log }) {
  const sheet = await Sheet.open(browser, url());
  await openSample(sheet);
  const session = await sheet.ask("session");
  const probe = { subdivide: { region: { sphere: { center: [0.76, 1.22, 0], radius: 0.2 } } } };
  const other = await server.json("POST", "/v1/sessions?sample=creature");
  try {
    await server.json("POST", `/v1/sessions/${other.id}/edits`, probe);
  } catch (error) {
    if (!/ 501 /.test(error.message)) throw error;
    log("SKIPPED: this server does not edit");
    await sheet.close();
    return;
  }
  const told = () => server.json("GET", `/v1/sessions/${session}`);
  const agrees = async (what) => {
    const [positions, facts] = [await sheet.positions(), await told()];
    assert.equal(positions.length / 3, facts.model.vertices, `${what}: as many vertices are drawn as there are`);
    assert.equal(compare(positions, await server.floats("GET", `/v1/sessions/${session}/positions`)).worst, 0, what);
    return facts;
  };
  const before = await agrees("opened");

  await sheet.page.getByText("Edit", { exact: true }).click();
  const step = async (act) => {
    const { revision } = await sheet.ask("state");
    await act();
    await sheet.until("the change arrives", (state) => state.revision !== revision && !state.busy);
  };
  await step(() => sheet.page.getByRole("button", { name: "Subdivide", exact: true }).click());
  const fine = await agrees("subdivided");
  log(`subdividing: ${before.model.triangles} → ${fine.model.triangles} triangles`);
  assert.equal(fine.model.triangles, before.model.triangles * 4);
  const [, head] = await sheet.ask("handles");
  assert.ok(head.vertices.length > 0, "the handle keeps its region");
  await dragGrip(sheet, head, [{ x: 40, y: -30 }]);
  await agrees("dragged after the edit");

  await sheet.page.getByRole("radio", { name: "X", exact: true }).click();
  await sheet.page.getByRole("radio", { name: "above", exact: true }).click();
  await step(() => sheet.page.getByRole("button", { name: "Cut", exact: true }).click());
  const half = await agrees("cut");
  assert.ok(half.model.triangles < fine.model.triangles, "one side is gone");
  await sheet.picture("cut");

  for (const what of ["the cut undone", "the drag undone", "the subdivision undone"]) {
    await step(() => sheet.key("Control+z"));
    await agrees(what);
  }
  assert.equal((await told()).model.triangles, before.model.triangles);
  assert.deepEqual(sheet.complaints, []);
  await sheet.close();
}
