/** A session that others set up: the page shows its pose, and goes on from there. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";

export const title = "handles set and posed elsewhere keep their poses when one of them is changed here";

const LIFT = 0.4;

export async function play({ browser, url, server, log }) {
  const { id } = await server.json("POST", "/v1/sessions?sample=creature");
  const path = `/v1/sessions/${id}`;
  const within = (min, max) => ({ box: { min, max } });
  await server.json("PUT", `${path}/handles`, {
    handles: [
      { id: "feet", region: within([-9, -9, -9], [9, 0.14, 9]) },
      { id: "head", region: within([0.4, 1, -9], [9, 9, 9]) },
    ],
  });
  const pivot = [0, 1, 0];
  const quarter = [0, Math.SQRT1_2, 0, Math.SQRT1_2];
  const pose = { translation: [0, LIFT, 0], rotation: quarter, pivot };
  const solved = await server.floats("POST", `${path}/solve`, { pose: { handles: [{ id: "head", pose }] } });
  const { handles } = await server.json("GET", path);
  const head = handles.find((handle) => handle.id === "head");
  if (head.pose === undefined) throw new Error("the server does not tell the pose of a handle that it has moved");

  const sheet = await Sheet.open(browser, `${url()}/?session=${id}`);
  await sheet.until("the page takes the session up", ({ link, busy }) => link === "open" && !busy);
  await sheet.page.waitForFunction(() => window.pliantViewer.handles().length === 2);
  const [feet, shown] = await sheet.ask("handles");
  assert.deepEqual(feet.pose, { translation: [0, 0, 0], rotation: [0, 0, 0], scale: [1, 1, 1], freely: false });
  // A quarter turn about y takes (x, z) to (z, -x): about the page's pivot instead, the difference is moved.
  const away = pivot.map((x, k) => x - shown.pivot[k]);
  const wanted = [away[0] - away[2], LIFT, away[2] + away[0]];
  shown.pose.translation.forEach((x, k) => assert.ok(Math.abs(x - wanted[k]) < 1e-9, `moved by ${shown.pose.translation}, not ${wanted}`));
  shown.pose.rotation.forEach((x, k) => assert.ok(Math.abs(x - [0, Math.PI / 2, 0][k]) < 1e-9, `turned by ${shown.pose.rotation}`));

  const { revision } = await sheet.ask("state");
  await sheet.page.getByRole("button", { name: "head", exact: false }).first().click();
  await sheet.page.getByLabel("Move X").fill(String(Number((wanted[0] + 0.01).toFixed(4))));
  await sheet.key("Enter");
  await sheet.until("the change is recorded", (state) => state.revision !== revision);
  const after = await server.floats("GET", `${path}/positions`);
  const top = (positions) => positions.reduce((most, y, k) => (k % 3 === 1 ? Math.max(most, y) : most), -Infinity);
  assert.ok(Math.abs(top(after) - top(solved)) < 0.02, `the top was at ${top(solved)} and is at ${top(after)}`);
  assert.deepEqual(sheet.complaints, []);
  await sheet.close();
  await server.json("DELETE", path).catch(() => undefined);
}
