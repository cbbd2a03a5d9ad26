/** A model with work in it is not thrown away by another file, nor by its cross: the page asks. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { finger } from "../models.mjs";
import { openSample } from "./sample.mjs";

export const title = "what was bent is kept or discarded as the user says, and asked about only when something was done";

export async function play({ browser, url, server }) {
  const sheet = await Sheet.open(browser, url());
  const { page } = sheet;
  const question = page.getByRole("alertdialog");
  const answer = (name) => question.getByRole("button", { name, exact: true });
  const opened = (what) => sheet.until(what, ({ link, busy }) => link === "open" && !busy);
  const isOpen = async (id) => (await fetch(`${server.url}/v1/sessions/${id}`)).status === 200;
  const bend = async () => {
    const { revision } = await sheet.ask("state");
    await page.getByRole("button", { name: /^Head/ }).first().click();
    await page.getByLabel("Move Y").fill("0.2");
    await sheet.key("Enter");
    await sheet.until("the pose is recorded", (state) => state.revision !== revision);
  };

  // Nothing was done: nothing is asked.
  await openSample(sheet);
  await page.getByRole("button", { name: "Close the model" }).click();
  await page.getByRole("heading", { name: "Bend a model" }).waitFor();
  assert.equal(await question.count(), 0);

  await openSample(sheet);
  const bent = await sheet.ask("session");
  await bend();
  // The keyboard is enough; Escape stays, and shortcuts wait.
  await sheet.drop(finger(600));
  await answer("Keep").waitFor();
  await sheet.picture("leaving");
  assert.ok(await answer("Keep").evaluate((button) => button === document.activeElement), "Keep has the focus");
  await sheet.key("Control+z");
  // Nor does another file act behind the question.
  await sheet.drop({ name: "notes.txt", mimeType: "text/plain", buffer: Buffer.from("no model") });
  await sheet.key("Escape");
  await question.waitFor({ state: "hidden" });
  assert.equal(await sheet.ask("session"), bent);
  assert.equal((await sheet.ask("state")).revision, "3", "nothing was undone behind the question");

  // Kept: the other model opens, and the start page goes on with the first.
  await sheet.drop(finger(600));
  await answer("Keep").waitFor();
  assert.equal(await page.getByText("Not a model").count(), 0, "what was dropped behind the question is not looked at");
  await sheet.key("Enter");
  await page.waitForFunction((before) => window.pliantViewer.session() !== before, bent);
  await opened("the other model opens");
  assert.ok(await isOpen(bent), "the bent one is still on the server");
  await page.getByRole("button", { name: "Close the model" }).click();
  await page.getByRole("region", { name: "Open on this server" }).getByRole("button", { name: "Resume" }).first().click();
  await opened("the bent one is taken up again");
  assert.equal(await sheet.ask("session"), bent);
  assert.equal((await sheet.ask("handles")).find(({ name }) => name === "Head").pose.translation[1], 0.2);

  // Discarded, by the cross.
  await page.getByRole("button", { name: "Close the model" }).click();
  await answer("Discard").click();
  await page.getByRole("heading", { name: "Bend a model" }).waitFor();
  for (const deadline = Date.now() + 30_000; (await isOpen(bent)) && Date.now() < deadline; );
  assert.ok(!(await isOpen(bent)), "the server has discarded it");
  assert.deepEqual(sheet.complaints, []);
  await sheet.close();
}
