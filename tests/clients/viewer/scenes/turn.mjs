/** A handle is wound past 180°: the page counts turns and the server is told the whole angle. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { asHandles, asPose, dragGrip, shows } from "./hold.mjs";
import { openSample } from "./sample.mjs";

export const title = "a handle is rotated by more than a turn";

export async function play({ browser, url, server, log }) {
  const sheet = await Sheet.open(browser, url());
  await openSample(sheet);
  await sheet.tool("Rotate the handle");
  const [, head] = await sheet.ask("handles");
  const centre = head.at;

  // The outermost ring turns in the plane of the screen: as far as the mouse circles the centre.
  const ring = await ringRadius(sheet, centre);
  const around = (degrees) => ({
    x: centre.x + ring * Math.cos((degrees * Math.PI) / 180),
    y: centre.y + ring * Math.sin((degrees * Math.PI) / 180),
  });
  const { revision } = await sheet.ask("state");
  const places = Array.from({ length: 41 }, (_, k) => around(-45 + k * 10));
  await sheet.drag(places, { steps: 1, pause: 16 });
  await sheet.until("the turn is recorded", (state) => state.revision !== revision);
  const [feet, turned] = await sheet.ask("handles");
  const degrees = (Math.hypot(...turned.pose.rotation) * 180) / Math.PI;
  log(`turned by ${degrees.toFixed(1)}°`);
  assert.ok(degrees > 380 && degrees < 420, `a circle and 40° more were drawn, the handle turned by ${degrees}°`);
  const tag = await sheet.page.locator(".tag").innerText();
  assert.match(tag, /1 turn \+ \d+°/);
  await sheet.picture("turned");

  const session = await server.json("POST", "/v1/sessions?sample=creature");
  await server.json("PUT", `/v1/sessions/${session.id}/handles`, { handles: asHandles([feet, turned]) });
  const solved = await server.floats("POST", `/v1/sessions/${session.id}/solve`, {
    pose: { handles: [{ id: turned.id, pose: asPose(turned) }] },
  });
  const { worst, diagonal } = await shows(sheet, solved);
  assert.ok(worst <= 1e-6 * diagonal, `shown and solved differ by ${worst}`);

  // The same by numbers, for those without a mouse; and the other two modes of the gizmo.
  const before = await sheet.ask("state");
  await sheet.page.getByLabel("Turn ° Y").fill("720");
  await sheet.key("Enter");
  await sheet.until("the number is recorded", (state) => state.revision !== before.revision);
  const [, typed] = await sheet.ask("handles");
  assert.ok(Math.abs(typed.pose.rotation[1] - 4 * Math.PI) < 1e-9, `720° are two turns, not ${typed.pose.rotation}`);
  await sheet.key("Escape");
  await sheet.tool("Scale the handle");
  await dragGrip(sheet, (await sheet.ask("handles"))[1], [{ x: 60, y: -40 }]);
  const [, scaled] = await sheet.ask("handles");
  assert.ok(scaled.pose.scale.every((x) => x > 0 && x !== 1), `scaled by ${scaled.pose.scale}`);
  assert.deepEqual(scaled.pose.rotation, typed.pose.rotation, "scaling leaves the turns alone");
  assert.deepEqual(sheet.complaints, []);
  await sheet.close();
}

/** How far from the centre the outer ring of the gizmo can be taken hold of. */
async function ringRadius(sheet, centre) {
  for (let radius = 60; radius < 260; radius += 3) {
    const at = -Math.PI / 4;
    await sheet.page.mouse.move(centre.x + radius * Math.cos(at), centre.y + radius * Math.sin(at));
    if ((await sheet.ask("state")).gizmoPart === "E") return radius;
  }
  throw new Error("the gizmo's outer ring was not found");
}
