/** Triangles that cross others are marked in the recorded shape, and no more when they do not. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { openSample } from "./sample.mjs";

export const title = "triangles that cross others are red, those of the recorded pose";

export async function play({ browser, url, server, log }) {
  const sheet = await Sheet.open(browser, url());
  await openSample(sheet);
  await sheet.page.getByRole("radio", { name: "crossings" }).click();
  await sheet.until("nothing crosses at rest", ({ crossings }) => crossings === 0);
  // The head goes into the body.
  for (const [axis, way] of [["X", -0.9], ["Y", -0.2]]) {
    const { revision } = await sheet.ask("state");
    await sheet.page.getByLabel(`Move ${axis}`).fill(String(way));
    await sheet.key("Enter");
    await sheet.until("it is recorded", (state) => state.revision !== revision && !state.busy);
  }
  const { crossings } = await sheet.until("crossings are found", (state) => state.crossings > 0);
  const id = await sheet.ask("session");
  const told = await server.json("POST", `/v1/sessions/${id}/crossings`, {});
  assert.equal(crossings, told.total);
  log(`${crossings} triangles cross others`);
  await sheet.page.getByText(/triangles cross another since the rest pose/).waitFor();
  await sheet.picture("crossings");
  await sheet.page.getByRole("button", { name: /^Undo/ }).click();
  await sheet.until("fewer after undo", (state) => state.crossings >= 0 && state.crossings < crossings);
  await sheet.page.getByRole("radio", { name: "plain" }).click();
  await sheet.until("not looked for", (state) => state.crossings === -1);
  assert.deepEqual(sheet.complaints, []);
  await sheet.close();
}
