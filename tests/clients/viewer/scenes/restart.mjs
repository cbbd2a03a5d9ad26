/** A lost socket costs nothing; a restarted server costs one click. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { serve } from "../proxy.mjs";
import { asHandles, asPose, compare, dragGrip, shows, takeGrip } from "./hold.mjs";
import { openSample } from "./sample.mjs";

export const title = "a socket is lost in mid-drag, the page is reloaded, the server is restarted";

export async function play({ browser, server, folder, log }) {
  const proxy = await serve(folder, () => server.url);
  try {
    const sheet = await Sheet.open(browser, proxy.url);
    await openSample(sheet);

    // The socket goes while the mouse holds the gizmo.
    const { mouse } = sheet.page;
    const { revision } = await sheet.ask("state");
    const head = await takeGrip(sheet);
    for (let k = 1; k <= 10; k++) await mouse.move(head.at.x + 5 * k, head.at.y - 2 * k);
    proxy.cut();
    for (let k = 1; k <= 10; k++) await mouse.move(head.at.x + 50 + 3 * k, head.at.y - 20 - 2 * k);
    await mouse.up();
    await sheet.until("the release is recorded after the socket came back", (state) => state.revision !== revision);
    const [feet, dragged] = await sheet.ask("handles");
    const session = await server.json("POST", "/v1/sessions?sample=creature");
    await server.json("PUT", `/v1/sessions/${session.id}/handles`, { handles: asHandles([feet, dragged]) });
    const solved = await server.floats("POST", `/v1/sessions/${session.id}/solve`, {
      pose: { handles: [{ id: dragged.id, pose: asPose(dragged) }] },
    });
    assert.equal((await shows(sheet, solved)).worst, 0, "the shape is the one that was dragged to");
    const id = await sheet.ask("session");

    await sheet.page.reload();
    await sheet.ready();
    await sheet.until("the page takes its session up again", ({ link, busy }) => link === "open" && !busy);
    assert.equal(await sheet.ask("session"), id, "the session is the same");
    assert.equal((await shows(sheet, solved)).worst, 0, "so is the shape");
    const [, resumed] = await sheet.ask("handles");
    assert.deepEqual(resumed.pose, dragged.pose, "and the pose");
    await dragGrip(sheet, resumed, [{ x: 20, y: 30 }]);
    const before = await server.floats("GET", `/v1/sessions/${id}/positions`);
    const [, last] = await sheet.ask("handles");
    assert.deepEqual(sheet.complaints.filter((text) => !/WebSocket|ERR_/.test(text)), []);

    await server.kill();
    await sheet.page.locator(".banner").waitFor();
    await sheet.picture("lost");
    await server.start();
    await sheet.page.getByRole("alertdialog").waitFor();
    await sheet.picture("gone");
    await sheet.page.getByRole("button", { name: "Open it again" }).click();
    await sheet.until("the model opens again", ({ link, busy }) => link === "open" && !busy);
    await sheet.page.waitForFunction(() => window.pliantViewer.handles().length === 2);
    await sheet.until("its pose is solved", ({ revision: now }) => now === "3");
    assert.notEqual(await sheet.ask("session"), id, "the session is another");
    assert.deepEqual((await sheet.ask("handles"))[1].pose, last.pose);
    const { worst, diagonal } = await shows(sheet, before, 1e-6 * compare(before, before).diagonal);
    log(`after the restart the shape differs by ${(worst / diagonal).toExponential(1)} of the box`);
    assert.ok(worst <= 1e-6 * diagonal, `the shape is as it was before the restart, but for ${worst}`);

    // The server ends while the mouse holds the gizmo: the pose that it was never told of is not lost either.
    const again = await takeGrip(sheet);
    for (let k = 1; k <= 10; k++) await mouse.move(again.at.x - 4 * k, again.at.y - 3 * k);
    await server.kill();
    for (let k = 1; k <= 10; k++) await mouse.move(again.at.x - 40 - 2 * k, again.at.y - 30 - k);
    await mouse.up();
    await sheet.page.locator(".banner").waitFor();
    const [, untold] = await sheet.ask("handles");
    assert.notDeepEqual(untold.pose, again.pose, "the handle was dragged");
    await server.start();
    await sheet.page.getByRole("alertdialog").waitFor();
    assert.equal(await sheet.page.locator(".notice.error").count(), 0, "no failure lies over the dialog");
    await sheet.page.getByRole("button", { name: "Open it again" }).click();
    await sheet.until("the model opens once more", ({ link, busy, revision: now }) => link === "open" && !busy && now === "3");
    const [, saved] = await sheet.ask("handles");
    assert.deepEqual(saved.pose, untold.pose, "the pose of the drag is there");
    const held = await server.floats("GET", `/v1/sessions/${await sheet.ask("session")}/positions`);
    assert.equal((await shows(sheet, held)).worst, 0, "and so is the shape");
    assert.ok(compare(held, before).worst > 0.01 * compare(held, before).diagonal, "which is another than before the drag");
    await sheet.close();
  } finally {
    proxy.stop();
  }
}
