/** Tabs of one browser: each finds its own model again. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { finger } from "../models.mjs";
import { holdBothEnds } from "./hold.mjs";
import { openSample } from "./sample.mjs";

/** As many models as the page keeps, and one more. */
const MANY = 9;

export const title = "two tabs keep their models apart, and old ones are forgotten";

export async function play({ browser, url }) {
  const first = await Sheet.open(browser, url());
  await first.pick(finger(2000));
  await first.until("the model opens", ({ link, busy }) => link === "open" && !busy);
  await holdBothEnds(first);
  const before = await first.ask("handles");

  const second = new Sheet(await first.page.context().newPage());
  await second.page.goto(url());
  await second.ready();
  await openSample(second);

  await first.page.reload();
  await first.ready();
  await first.until("the first tab takes its session up again", ({ link, busy }) => link === "open" && !busy);
  await first.page.waitForFunction(() => window.pliantViewer.handles().length === 2);
  const after = await first.ask("handles");
  const known = (handles) => handles.map(({ id, name, vertices, pose }) => ({ id, name, vertices, pose }));
  assert.deepEqual(known(after), known(before), "names, regions and poses are as they were");
  assert.deepEqual(
    (await second.ask("handles")).map(({ name }) => name),
    ["Feet", "Head"],
  );

  // Closing a model forgets it; of those that are left, the newest stay.
  const records = () =>
    second.page.evaluate(
      () =>
        new Promise((resolve, reject) => {
          const opening = indexedDB.open("pliant-viewer");
          opening.onerror = () => reject(opening.error);
          opening.onsuccess = () => {
            const asked = opening.result.transaction("models").objectStore("models").getAllKeys();
            asked.onsuccess = () => {
              opening.result.close();
              resolve(asked.result);
            };
          };
        }),
    );
  const kept = await first.ask("session");
  assert.ok((await records()).includes(kept));
  assert.ok((await records()).includes(await second.ask("session")));
  const copies = async (count) =>
    second.page.evaluate(
      ([from, many]) =>
        new Promise((resolve, reject) => {
          const opening = indexedDB.open("pliant-viewer");
          opening.onerror = () => reject(opening.error);
          opening.onsuccess = () => {
            const writing = opening.result.transaction("models", "readwrite");
            const store = writing.objectStore("models");
            store.get(from).onsuccess = ({ target }) => {
              for (let k = 0; k < many; k++) store.put({ ...target.result, session: `old-${k}`, keptAt: k });
            };
            writing.oncomplete = () => {
              opening.result.close();
              resolve();
            };
          };
        }),
      [kept, count],
    );
  await copies(MANY);
  await second.page.getByRole("button", { name: "Close the model" }).click();
  await openSample(second);
  const now = await second.ask("session");
  for (const deadline = Date.now() + 30_000; (await records()).length > MANY - 1 && Date.now() < deadline; ) {
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
  const left = await records();
  assert.equal(left.length, MANY - 1, `records that are left: ${left}`);
  assert.ok(left.includes(kept) && left.includes(now), "the newest stay");
  assert.deepEqual(first.complaints, []);
  assert.deepEqual(second.complaints, []);
  await first.close();
}
