/** One session in two windows: what one of them changes the other shows, and it does nothing to a state that it has not shown. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { openSample } from "./sample.mjs";

export const title = "a window shows what another one changed, and does not undo it unseen";

export async function play({ browser, url, server }) {
  const first = await Sheet.open(browser, url());
  await openSample(first);
  const id = await first.ask("session");
  const path = `/v1/sessions/${id}`;
  const second = new Sheet(await first.page.context().newPage());
  await second.page.goto(url());
  await second.ready();
  const list = second.page.getByRole("region", { name: "Open on this server" });
  await list.locator(".session").first().getByRole("button", { name: "Resume" }).click();
  await second.until("the second window takes the session up", ({ link, busy }) => link === "open" && !busy);
  assert.equal(await second.ask("session"), id);

  const move = async (sheet, axis, by) => {
    await sheet.page.getByRole("button", { name: /^Head/ }).first().click();
    await sheet.page.getByLabel(`Move ${axis}`).fill(String(by));
    await sheet.key("Enter");
  };
  const history = () => server.json("GET", `${path}/history`);
  const isShown = async (sheet) => assert.deepEqual(await sheet.positions(), await server.floats("GET", `${path}/positions`), "the shape is the server's");
  const told = (sheet, text) => sheet.page.getByText(text, { exact: true }).first().waitFor();

  // Undo in a window that has not shown the pose shows it, and undoes nothing.
  await move(first, "X", 0.2);
  const posed = await first.until("the pose is recorded", ({ revision }) => revision === "3");
  await second.key("Control+z");
  await told(second, "Changed in another window");
  await told(second, "Not done: Undo");
  await second.until("the second window shows the pose", ({ revision }) => revision === posed.revision);
  assert.equal((await history()).current, posed.revision, "nothing was undone");
  await isShown(second);
  const poses = (handles) => handles.map(({ name, vertices, pose }) => ({ name, vertices, pose }));
  assert.deepEqual(poses(await second.ask("handles")), poses(await first.ask("handles")));
  // Now it does, and says what it was.
  await second.key("Control+z");
  await told(second, "Undone: Head posed");
  assert.equal((await history()).current, "2");

  // The window that gets the focus looks by itself.
  await first.page.evaluate(() => dispatchEvent(new Event("focus")));
  await first.until("the first window shows that it was undone", ({ revision }) => revision === "2");
  await told(first, "Changed in another window");
  await isShown(first);

  // A handle of a program's, and then a pose of a window that has not heard of it: the pose is recorded, both are shown.
  await server.json("PATCH", `${path}/handles/tail`, { region: { box: { min: [-9, 0.9, -9], max: [-0.5, 9, 9] } } });
  await move(first, "Y", 0.1);
  await first.page.waitForFunction(() => window.pliantViewer.handles().length === 3);
  await first.until("the pose is recorded", ({ revision, busy }) => Number(revision) > 5 && !busy);
  await isShown(first);
  assert.equal((await history()).commits.at(-1).kind, "pose");
  // A handle that the second window removes by its list, which is old by now, stays.
  await second.page.getByRole("button", { name: "Remove Head" }).click();
  await told(second, "Not done: Head removed");
  assert.equal((await server.json("GET", path)).handles.length, 3);
  assert.deepEqual(first.complaints, []);
  assert.deepEqual(second.complaints, []);
  await first.close();
  await server.json("DELETE", path).catch(() => undefined);
}
