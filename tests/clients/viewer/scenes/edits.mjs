/** Edits: the page shows the new topology, drags it, and undo brings the old one back. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { dragGrip, shows } from "./hold.mjs";
import { openSample } from "./sample.mjs";

export const title = "cut, subdivide and the remesh brush change what is drawn; undo and redo cross them to the bit";

export async function play({ browser, url, server, log }) {
  const sheet = await Sheet.open(browser, url());
  await openSample(sheet);
  const session = await sheet.ask("session");
  const told = () => server.json("GET", `/v1/sessions/${session}`);
  const buffer = () => server.floats("GET", `/v1/sessions/${session}/positions`);
  const agrees = async (what) => {
    const [wanted, facts] = [await buffer(), await told()];
    assert.equal(wanted.length / 3, facts.model.vertices);
    assert.equal((await shows(sheet, wanted)).worst, 0, `${what}: what is drawn is what the server holds`);
    return { ...facts.model, positions: wanted };
  };
  const step = async (what, act) => {
    const { revision } = await sheet.ask("state");
    await act();
    await sheet.until(`${what} arrives`, (state) => state.revision !== revision && !state.busy);
    return agrees(what);
  };
  const opened = await agrees("opened");
  await sheet.page.locator("summary").getByText("Edit", { exact: true }).click();

  // Triangles of the head alone, by a stroke of the remesh brush. The length is below the creature's own.
  await sheet.page.getByLabel("Edge length").fill("0.02");
  await sheet.key("Enter");
  await sheet.page.getByRole("button", { name: "Brush", exact: true }).click();
  const [, before] = await sheet.ask("handles");
  const brushed = await step("the remesh brush", () =>
    sheet.drag([{ x: before.at.x - 30, y: before.at.y }, { x: before.at.x + 30, y: before.at.y + 10 }], { steps: 8 }),
  );
  log(`remesh brush: ${opened.triangles} → ${brushed.triangles} triangles`);
  assert.notEqual(brushed.triangles, opened.triangles);
  assert.ok(brushed.triangles < opened.triangles * 3, "the rest of the creature keeps its triangles");
  assert.equal((await sheet.ask("state")).selected, 0, "the stroke is not a selection");
  const undone = await step("the brush undone", () => sheet.key("Control+z"));
  assert.deepEqual(undone.positions, opened.positions);
  const redone = await step("the brush redone", () => sheet.key("Control+y"));
  assert.deepEqual(redone.positions, brushed.positions, "redo makes the same triangles");
  await step("undone once more", () => sheet.key("Control+z"));

  const button = (name) => sheet.page.getByRole("button", { name, exact: true });
  const fine = await step("subdividing", () => button("Subdivide").click());
  assert.equal(fine.triangles, opened.triangles * 4);
  await sheet.tool("Move the handle");
  const [, head] = await sheet.ask("handles");
  const held = (await told()).handles.find(({ id }) => id === head.id);
  assert.equal(held.vertices, head.vertices.length, "page and server agree on what the handle holds");
  const { revision } = await dragGrip(sheet, head, [{ x: 40, y: -30 }], { steps: 6 });
  const dragged = await agrees("dragged after the edit");
  const solveHandles = await told();
  assert.equal(solveHandles.revision, revision);

  await sheet.page.getByRole("radio", { name: "X", exact: true }).click();
  await sheet.page.getByRole("radio", { name: "above", exact: true }).click();
  await sheet.picture("cutting");
  const half = await step("cutting", () => button("Cut").click());
  assert.ok(half.triangles < fine.triangles * 0.8, "one side is gone");
  await sheet.picture("cut");
  log(`subdividing: ${opened.triangles} → ${fine.triangles}; cutting: → ${half.triangles} triangles`);

  // What an edit made is the rest shape; going back across it, the former rest shape and the poses are back.
  await sheet.key("k");
  await sheet.page.getByText("as in the rest pose").waitFor();
  await sheet.picture("cut-stretch");
  const whole = await step("the cut undone", () => sheet.key("Control+z"));
  assert.deepEqual(whole.positions, dragged.positions);
  const [, posed] = await sheet.ask("handles");
  assert.ok(posed.pose.translation.some((x) => x !== 0), "the pose of before the cut is back");
  await sheet.picture("uncut-stretch");
  await sheet.key("k");
  for (const what of ["the drag undone", "the subdivision undone"]) await step(what, () => sheet.key("Control+z"));
  assert.deepEqual((await buffer()), opened.positions);
  assert.equal((await told()).model.triangles, opened.triangles);

  // A refusal is told in the server's words and changes nothing.
  const errors = sheet.complaints.length;
  await sheet.page.getByLabel("Edge length").fill("0.00001");
  await sheet.key("Enter");
  await button("Remesh").click();
  await sheet.page.getByText("Remeshing failed").waitFor();
  await sheet.picture("edit-refused");
  await agrees("refused");
  sheet.complaints = sheet.complaints.filter((text, k) => k < errors || !/Failed to load resource/.test(text));
  assert.deepEqual(sheet.complaints, []);
  await sheet.close();
}
