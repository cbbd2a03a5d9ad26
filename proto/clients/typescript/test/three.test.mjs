/** The surface of a session as a geometry of three.js. */

import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { after, before, test } from "node:test";
import { Mesh, Raycaster, Vector3 } from "three";
import { Client } from "../dist/index.js";
import { PliantGeometry } from "../dist/three.js";
import { skip, start } from "./server.mjs";

const FEET = { id: "feet", region: { halfSpace: { normal: [0, -1, 0], offset: -0.14 } } };
const HEAD = { id: "head", region: { sphere: { center: [0.76, 1.22, 0], radius: 0.36 } } };
let server;
let session;

before(async () => {
  if (skip) return;
  server = await start();
  session = await new Client({ url: server.url }).sample();
  await session.setHandles({ handles: [FEET, HEAD] });
});
after(async () => {
  await session?.close();
  server?.stop();
});

test("nothing but pliant-client/three asks for three.js", () => {
  const dist = new URL("../dist/", import.meta.url);
  const asking = readdirSync(dist).filter((name) => name.endsWith(".js") && /from "three"|"\.\/three\.js"/.test(readFileSync(new URL(name, dist), "utf8")));
  assert.deepEqual(asking, ["three.js"]);
});

test("triangles join rows of positions", { skip }, async () => {
  const triangles = await session.triangles();
  assert.equal(triangles.length, 3 * session.facts.model.triangles);
  assert.deepEqual(triangles, (await session.topology()).indices);
  assert.ok(triangles.every((vertex) => vertex < session.facts.model.vertices));
});

/** How high a ray from above meets the mesh. */
function heightAt(geometry, x) {
  geometry.computeBoundingSphere();
  const [{ point }] = new Raycaster(new Vector3(x, 10, 0), new Vector3(0, -1, 0)).intersectObject(new Mesh(geometry));
  return point.y;
}

for (const normals of [false, true]) {
  test(`frames move the geometry in place, ${normals ? "with the server's normals" : "and normals follow"}`, { skip }, async () => {
    const geometry = await PliantGeometry.of(session);
    const { position, normal } = geometry.attributes;
    assert.deepEqual(position.array, await session.positions());
    assert.deepEqual(new Uint32Array(geometry.index.array), await session.triangles());
    const [array, versions, before, height] = [position.array, [position.version, normal.version], normal.array.slice(), heightAt(geometry, 0.76)];
    const stream = session.stream({ output: { encoding: "U16", normals } });
    assert.equal(geometry.take(stream), undefined, "nothing has come");
    stream.pose([{ id: "head", pose: { translation: [0, 0.3, 0], rotationVector: [0, 0.4, 0] } }]);
    let frame;
    while (frame === undefined) {
      await new Promise((resolve) => setTimeout(resolve, 5));
      frame = geometry.take(stream);
    }
    assert.equal(frame.hasNormals, normals);
    assert.equal(position.array, array, "the same buffer");
    assert.ok(position.version > versions[0] && normal.version > versions[1]);
    assert.ok(Math.abs(heightAt(geometry, 0.76) - height - 0.3) < 0.1);
    assert.notDeepEqual(normal.array, before);
    for (let v = 0; v < normal.count; v++) assert.ok(Math.abs(Math.hypot(normal.getX(v), normal.getY(v), normal.getZ(v)) - 1) < 1e-3);
    stream.close();
  });
}
