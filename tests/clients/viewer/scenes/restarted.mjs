/** With a folder for its sessions a server that is started again costs nothing: what the mouse holds goes on. */

import assert from "node:assert/strict";
import { mkdtemp, rm } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { Sheet } from "../browser.mjs";
import { serve } from "../proxy.mjs";
import { Server } from "../server.mjs";
import { shows, takeGrip } from "./hold.mjs";
import { openSample } from "./sample.mjs";

export const title = "a server that keeps its sessions is stopped, and killed, in mid-drag and started again";

export async function play({ browser, folder, log }) {
  const kept = await mkdtemp(join(tmpdir(), "pliant-viewer-"));
  // Far more time than a page needs to leave: a server that waited for it would need all of it.
  const server = await Server.start("--data-dir", join(kept, "data"), "--drain-deadline", "300s");
  const proxy = await serve(folder, () => server.url);
  try {
    const sheet = await Sheet.open(browser, proxy.url);
    await openSample(sheet);
    const id = await sheet.ask("session");
    const { mouse } = sheet.page;
    const history = async () => (await server.json("GET", `/v1/sessions/${id}/history`)).commits.map(({ kind }) => kind);
    assert.deepEqual(await history(), ["create", "handles"]);

    const shapes = [];
    for (const [rounds, end] of [
      [1, () => server.stop()],
      [2, () => server.kill()],
    ]) {
      const { revision } = await sheet.ask("state");
      const head = await takeGrip(sheet);
      const down = rounds === 1 ? 1 : -1;
      for (let k = 1; k <= 10; k++) await mouse.move(head.at.x + 4 * k, head.at.y + 3 * k * down);
      const ended = await end();
      assert.ok(ended === 0 || ended === "SIGKILL", `the server ended with ${ended}`);
      for (let k = 1; k <= 10; k++) await mouse.move(head.at.x + 40 + 2 * k, head.at.y + (30 + k) * down);
      await sheet.page.locator(".banner").waitFor();
      if (rounds === 1) await sheet.picture("reconnecting");
      // Released while nobody is there: recorded by the server that comes.
      await mouse.up();
      await server.start();
      await sheet.until("the release is recorded", (state) => state.link === "open" && state.revision !== revision);
      assert.deepEqual(await history(), ["create", "handles", ...Array(rounds).fill("pose")], "once");
      assert.equal(await sheet.ask("session"), id, "it is the same session");
      const held = await server.floats("GET", `/v1/sessions/${id}/positions`);
      shapes.push(held);
      assert.equal((await shows(sheet, held)).worst, 0, "and the shape on the screen is the one that was recorded");
      const [, dragged] = await sheet.ask("handles");
      assert.notDeepEqual(dragged.pose, head.pose, "the handle is where it was dragged to");
    }
    assert.equal(await sheet.page.getByRole("alertdialog").count(), 0, "nothing is to be opened again");
    assert.equal(await sheet.page.locator(".notice.error").count(), 0, "nothing failed");

    const { revision } = await sheet.ask("state");
    await sheet.key("Control+z");
    await sheet.until("undo goes back over the restart", (state) => state.revision !== revision);
    assert.equal((await shows(sheet, shapes[0])).worst, 0, "to the shape of the first drag, to the bit");
    log("two restarts in mid-drag: one session, two commits");
    await sheet.close();
  } finally {
    proxy.stop();
    await server.kill();
    await rm(kept, { recursive: true, force: true });
  }
}
