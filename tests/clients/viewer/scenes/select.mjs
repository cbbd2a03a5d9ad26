/** The ways to select, kinds of handles, and what the panels say. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { finger } from "../models.mjs";

export const title = "a dropped file opens; brush, lasso and part select; pins, soft handles and removal reach the server";

export async function play({ browser, url, server, log }) {
  const sheet = await Sheet.open(browser, url());
  await sheet.drop(finger(2000));
  await sheet.until("the model opens", ({ link, busy }) => link === "open" && !busy);
  const { vertices } = await sheet.ask("state");
  const { left, right, top, bottom } = await sheet.outline();
  const centre = { x: (left + right) / 2, y: (top + bottom) / 2 };
  const selected = async () => (await sheet.ask("state")).selected;

  await sheet.key("b");
  await sheet.drag([
    { x: centre.x, y: bottom - 30 },
    { x: centre.x + 10, y: bottom - 60 },
  ]);
  const painted = await selected();
  assert.ok(painted > 0 && painted < vertices / 2, `the brush selected ${painted} of ${vertices}`);
  await sheet.drag([{ x: centre.x, y: bottom - 30 }, { x: centre.x + 10, y: bottom - 60 }], { holding: ["Alt"] });
  assert.ok((await selected()) < painted, "Alt takes away");
  await sheet.key("Escape");
  assert.equal(await selected(), 0, "Escape clears");

  // What is hidden is not painted unless asked for.
  const across = [
    { x: left - 5, y: centre.y - 40 },
    { x: right + 5, y: centre.y + 40 },
  ];
  await sheet.key("x");
  await sheet.drag(across);
  const front = await selected();
  await sheet.key("t");
  await sheet.drag(across);
  const through = await selected();
  log(`the box holds ${front} visible vertices of ${through}`);
  assert.ok(front > 0 && through > front * 1.5, "the far side is hidden");
  await sheet.key("t");

  await sheet.key("l");
  await sheet.drag([
    { x: centre.x - 60, y: top - 10 },
    { x: centre.x + 60, y: top - 10 },
    { x: centre.x + 60, y: top + 60 },
    { x: centre.x - 60, y: top + 60 },
  ]);
  const caught = await selected();
  assert.ok(caught > 0 && caught < vertices / 2, `the lasso caught ${caught}`);
  await sheet.key("o");
  await sheet.page.waitForFunction(() => window.pliantViewer.handles().length === 1);

  await sheet.key("c");
  await sheet.page.mouse.click(centre.x, centre.y);
  assert.equal(await selected(), vertices, "a click takes the whole part");
  await sheet.key("i");
  assert.equal(await selected(), 0, "inverted, nothing is left");

  const session = await sheet.ask("session");
  const told = () => server.json("GET", `/v1/sessions/${session}`);
  assert.equal((await told()).handles[0].vertices, caught);

  // The soft handle's stiffness and falloff go to the server; what falls off reaches further.
  await sheet.page.getByLabel("Falloff", { exact: true }).selectOption("SMOOTH");
  await sheet.page.waitForFunction(() => document.querySelector("[aria-label='Falloff radius in model units']") !== null);
  await sheet.page.getByLabel("Falloff radius in model units").fill("0.6");
  await sheet.key("Enter");
  await sheet.page.getByLabel("Stiffness").fill("3");
  await sheet.key("Enter");
  await sheet.until("the last change is recorded", ({ revision }) => revision === "5");
  const { commits } = await server.json("GET", `/v1/sessions/${session}/history`);
  assert.equal(commits.length, 5, `opened, handle, falloff, radius, stiffness: ${JSON.stringify(commits.map((c) => c.kind))}`);

  await sheet.page.getByRole("button", { name: "Remove Soft 1" }).click();
  await sheet.page.waitForFunction(() => window.pliantViewer.handles().length === 0);
  assert.equal((await told()).handles.length, 0);
  assert.deepEqual(sheet.complaints, []);
  await sheet.close();
}
