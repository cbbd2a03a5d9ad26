/** The client against a server. */

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { Client, PliantError, regionOf, schema } from "../dist/index.js";
import { skip, start } from "./server.mjs";

let client;
let server;

before(async () => {
  if (skip) return;
  server = await start();
  client = new Client({ url: server.url });
});

after(() => server?.stop());

const FEET = { id: "feet", region: { halfSpace: { normal: [0, -1, 0], offset: -0.14 } } };
const HEAD = { id: "head", region: { sphere: { center: [0.76, 1.22, 0], radius: 0.36 } } };
const NOD = [{ id: "head", pose: { rotationVector: [0, 0, -0.4] } }];

test("a drag ends where a solve of the same pose ends, to the bit", { skip }, async () => {
  const session = await client.sample();
  const twin = await client.sample();
  for (const each of [session, twin]) await each.setHandles({ handles: [FEET, HEAD] });
  const positions = await session.positions();
  const stream = session.stream({}, { onFrame: () => stream.take(positions) });
  for (let k = 1; k <= 20; k++) stream.pose([{ id: "head", pose: { rotationVector: [0, 0, -0.02 * k] } }]);
  const frame = await stream.commit(NOD);
  assert.ok(frame.final && frame.revision === 3);
  assert.ok(frame.quality !== undefined && frame.quality.flippedTriangles === 0);
  const solved = await twin.solve(NOD);
  assert.deepEqual(positions, solved.positions);
  assert.deepEqual(solved.quality, frame.quality, "what the shape is like is told either way");
  assert.deepEqual(await session.positions(), solved.positions);

  await session.undo();
  assert.notDeepEqual(await session.positions(), solved.positions);
  await session.redo();
  const { commits, current } = await session.history();
  assert.deepEqual(commits.map(({ kind }) => kind), ["create", "handles", "pose"]);
  assert.equal(commits.at(-1).digest, solved.digest);
  assert.equal(current, commits.at(-1).revision);
  stream.close();
  await Promise.all([session.close(), twin.close()]);
});

test("points and models ride along", { skip }, async () => {
  const session = await client.sample();
  await session.setHandles({ handles: [FEET, HEAD] });
  const hat = [0.76, 1.6, 0];
  assert.deepEqual([...(await session.carry(hat)).points], hat);
  await session.solve([{ id: "head", pose: { translation: [0, 0.3, 0.1] } }]);
  const carried = await session.carry([...hat, 0.76, 1.22, 0]);
  assert.equal(carried.points.length, 6);
  assert.equal(carried.rotations.length, 8);
  assert.ok(Math.hypot(carried.points[0] - 0.76, carried.points[1] - 1.9, carried.points[2] - 0.1) < 0.03, `${carried.points}`);
  assert.ok(carried.scales.every((scale) => Math.abs(scale - 1) < 0.2));
  const hull = new TextEncoder().encode("OFF\n3 1 0\n0.7 1.5 0\n0.8 1.6 0\n0.9 1.5 0\n3 0 1 2\n");
  const text = new TextDecoder().decode((await session.carryModel(hull, "off")).model);
  assert.ok(text.startsWith("OFF") && Math.abs(Number(text.split("\n")[2].split(" ")[1]) - 1.8) < 0.05, text);
  // A splat without a rotation.
  const splat = new Uint8Array([...new Uint8Array(new Float32Array([0.8, 1.6, 0, 0.1, 0.1, 0.1]).buffer), 255, 255, 255, 255, 128, 128, 128, 128]);
  const { model, warnings } = await session.carryModel(splat, "splat");
  assert.deepEqual([model.length, warnings.map(({ code }) => code)], [splat.length, ["splats-unsound"]]);
  await assert.rejects(session.carry([1, 2]), (error) => error instanceof PliantError && error.message.includes("points"));
  await session.close();
});

for (const name of ["U16", "MESHOPT", "DELTA"]) {
  // By its name in the schema, and one of them by its number.
  const encoding = name === "MESHOPT" ? schema.Frame_Encoding[name] : name;
  test(`${name} frames are the same shape to a step`, { skip }, async () => {
    const session = await client.sample();
    await session.setHandles({ handles: [FEET, HEAD] });
    const target = await session.positions();
    // Every other frame is looked at, the others only come.
    let frames = 0;
    const stream = session.stream({ output: { encoding, normals: true } }, { onFrame: () => frames++ % 2 === 1 && stream.take(target) });
    for (let degrees = 1; degrees <= 20; degrees++) {
      stream.pose([{ id: "head", pose: { rotationVector: [0, degrees / 100, 0] } }]);
      await new Promise((resolve) => setTimeout(resolve, 5));
    }
    await stream.commit(NOD);
    const normals = new Float32Array(target.length);
    // Once more, of one that certainly waits.
    frames = 0;
    await stream.commit(NOD);
    assert.ok(stream.take(target, normals) !== undefined);
    const exact = await session.positions();
    const worst = exact.reduce((most, x, k) => Math.max(most, Math.abs(x - target[k])), 0);
    assert.ok(worst > 0 && worst < 1e-4, `off by ${worst}`);
    for (let k = 0; k < normals.length; k += 3) {
      assert.ok(Math.abs(Math.hypot(normals[k], normals[k + 1], normals[k + 2]) - 1) < 1e-3);
    }
    assert.equal(stream.totals.reconnects, 0);
    stream.close();
    await session.close();
  });
}

test("a model goes up, handles are put and taken, the bent model comes back", { skip }, async () => {
  const sample = await client.sample();
  const file = await sample.model("glb");
  await sample.close();
  const session = await client.open(file, { create: { label: "live test", volumeGraph: { mode: 1 } } });
  assert.equal(session.facts.label, "live test");
  assert.equal(session.facts.solver.graphVertices, session.facts.solver.solverVertices);
  await session.putHandle({ id: "some", region: regionOf([0, 1, 2, 3, 4, 5, 9]) });
  assert.equal(session.facts.handles[0].vertices, 7);
  await session.removeHandle("some");
  assert.equal(session.facts.handles.length, 0);
  const bytes = new Uint8Array(await (await session.model()).arrayBuffer());
  assert.deepEqual(bytes, new Uint8Array(await file.arrayBuffer()), "nothing was bent");
  assert.ok((await client.sessions()).some(({ id }) => id === session.id));
  assert.ok((await client.limits()).window >= 2);
  await session.close();
});

test("triangles have the vertices of frames, of a PLY of any form too, and a curve leads them", { skip }, async () => {
  const head = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n";
  const rows = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n0.5 0.5 1\n4 0 1 2 3\n3 0 1 4\n";
  const file = new Blob([`${head}element face 2\nproperty list uchar int vertex_indices\nend_header\n${rows}`]);
  for (const session of [await client.open(file), await client.sample()]) {
    const { positions, indices } = await session.topology();
    assert.deepEqual(positions, await session.positions());
    assert.equal(indices.length, 3 * session.facts.model.triangles);
    assert.ok(indices.every((vertex) => 3 * vertex < positions.length));
    const all = { halfSpace: { normal: [0, 0, 1], offset: -9 } };
    const guide = { shape: { case: "curve", value: { points: [0, 0, 0, 1, 0, 0] } } };
    await session.setHandles({ handles: [{ id: "led", region: all, stiffness: 1000, guide }] });
    const { positions: led } = await session.solve([{ id: "led", pose: { guide: { positions: [0, 2, 0, 1, 2, 0] } } }]);
    assert.ok(led.every((x, k) => Math.abs(x - positions[k] - (k % 3 === 1 ? 2 : 0)) < 1e-3), "it moved up with its curve");
    await assert.rejects(session.solve([{ id: "led", pose: { guide: 5 } }]), /guide/);
    await session.close();
  }
});

test("fields of a handle are replaced and cleared one by one", { skip }, async () => {
  const session = await client.sample();
  await session.setHandles({ handles: [FEET, HEAD] });
  const rest = await session.positions();
  const up = [{ id: "head", pose: { translation: [0, 0.3, 0] } }];
  // Vertices of the region that are where the pose says.
  const held = (positions) => rest.reduce((n, x, k) => n + (k % 3 === 1 && Math.abs(positions[k] - x - 0.3) < 1e-6 ? 1 : 0), 0);
  const count = session.facts.handles[1].vertices;
  assert.ok(held((await session.solve(up)).positions) >= count);
  await session.putHandle({ id: "head", stiffness: 0.01 });
  assert.ok(held((await session.solve(up)).positions) < count / 2, "a soft handle pulls and does not hold");
  await session.putHandle({ id: "head" }, { clear: ["stiffness"] });
  assert.ok(held((await session.solve(up)).positions) >= count);
  await session.close();
});

test("a model with companion files goes up as a form", { skip }, async () => {
  const gltf = {
    asset: { version: "2.0" },
    buffers: [{ uri: "three points.bin", byteLength: 36 }],
    bufferViews: [{ buffer: 0, byteLength: 36 }],
    accessors: [{ bufferView: 0, componentType: 5126, count: 3, type: "VEC3", min: [0, 0, 0], max: [1, 1, 0] }],
    meshes: [{ primitives: [{ attributes: { POSITION: 0 } }] }],
    nodes: [{ mesh: 0 }],
    scenes: [{ nodes: [0] }],
  };
  const points = new Blob([Float32Array.from([0, 0, 0, 1, 0, 0, 0, 1, 0])]);
  const model = new Blob([JSON.stringify(gltf)]);
  const session = await client.open(model, { create: { format: "gltf" }, companions: new Map([["three points.bin", points]]) });
  assert.deepEqual([...(await session.positions())], [0, 0, 0, 1, 0, 0, 0, 1, 0]);
  await session.close();
});

test("failures carry the server's code and text", { skip }, async () => {
  await assert.rejects(client.session("0".repeat(32)), (error) => error instanceof PliantError && error.isGone && error.status === 404);
  await assert.rejects(client.open(new Blob(["no model"]), { create: { format: "glb" } }), (error) => /glb/.test(error.message));
  const session = await client.sample();
  await assert.rejects(session.solve(NOD), { code: "FAILED_PRECONDITION" });
  await session.close();
  await assert.rejects(new Client({ url: "http://127.0.0.1:9" }).limits(), { code: "UNREACHABLE" });
});

test("a stream on a session that is closed ends as gone", { skip }, async () => {
  const session = await client.sample();
  await session.setHandles({ handles: [FEET, HEAD] });
  const states = [];
  const gone = new Promise((resolve) => {
    const stream = session.stream({}, { onState: (state) => (states.push(state), state === "gone" && resolve(stream)) });
    stream.commit(NOD).then(() => session.close());
  });
  await gone;
  assert.equal(states[0], "open");
});

test("every way to name vertices reaches the server, and says what is wrong with it", { skip }, async () => {
  const session = await client.sample();
  const rest = await session.positions();
  const vertices = rest.length / 3;
  const at = (k) => [rest[3 * k], rest[3 * k + 1], rest[3 * k + 2]];
  const within = (test) => Array.from({ length: vertices }, (_, k) => k).filter((k) => test(...at(k)));
  const holds = async (region) => {
    const { handles } = await session.setHandles({ handles: [{ id: "it", region }] });
    return handles[0].vertices;
  };
  const ball = within((x, y, z) => Math.hypot(x - 0.76, y - 1.22, z) <= 0.36);
  assert.equal(await holds({ sphere: { center: [0.76, 1.22, 0], radius: 0.36 } }), ball.length);
  assert.equal(await holds({ vertices: [...ball].reverse() }), ball.length, "in any order");
  assert.equal(await holds({ vertices: Uint32Array.from(ball) }), ball.length);
  assert.equal(await holds({ halfSpace: { normal: [0, 1, 0], offset: 1 } }), within((_, y) => y >= 1).length);
  assert.equal(await holds({ box: { min: [0, 1, -9], max: [9, 9, 9] } }), within((x, y) => x >= 0 && y >= 1).length);
  const onAxis = within((x, y, z) => Math.hypot(x - 0.76, z) <= 0.35 && y >= 1 && y <= 1.3).length;
  assert.ok((await holds({ capsule: { from: [0.76, 1, 0], to: [0.76, 1.3, 0], radius: 0.35 } })) >= onAxis && onAxis > 0);
  assert.ok((await holds({ tube: { points: [[0.76, 1, 0], [0.76, 1.3, 0], [0.9, 1.3, 0]], radius: 0.35 } })) >= onAxis);
  assert.equal(await holds({ component: 0 }), vertices);
  assert.equal(await holds({ primitive: 0 }), vertices);
  const weights = new Float32Array(vertices);
  for (const k of ball) weights[k] = 0.5;
  assert.equal(await holds({ weights }), ball.length);
  // The schema's message, and one that was made.
  assert.equal(await holds({ region: { case: "component", value: { index: 0 } } }), vertices);
  assert.equal(await holds(regionOf(ball)), ball.length);

  await session.setHandles({ handles: [HEAD], regionOfInterest: { halfSpace: { normal: [0, 1, 0], offset: 0.9 } } });
  const moved = await session.solve([{ id: "head", pose: { translation: [0, 0.2, 0] } }]);
  const low = within((_, y) => y < 0.9);
  assert.ok(low.every((k) => moved.positions[3 * k + 1] === rest[3 * k + 1]), "what is outside of the region of interest stays");

  const refused = (region, words) => {
    const failure = (error) => error instanceof PliantError && error.code === "INVALID_ARGUMENT" && words.test(error.message);
    return assert.rejects(session.putHandle({ id: "it", region }), failure);
  };
  await refused({ ball: { center: [0, 0, 0], radius: 1 } }, /ball is given, exactly one of vertices, halfSpace, sphere/);
  await refused({ component: 0, primitive: 0 }, /component and primitive is given/);
  await refused({}, /nothing is given/);
  await refused({ sphere: undefined, box: 5 }, /box/);
  await session.close();
});

test("a file that is opened gives its session a name", { skip }, async () => {
  const glb = await (await fetch(`${server.url}/v1/sample.glb`)).blob();
  const session = await client.open(new File([glb], "dog.glb"));
  assert.equal(session.facts.label, "dog.glb");
  assert.ok(Math.abs(Date.parse(session.facts.createdAt) - Date.now()) < 3_600_000);
  const other = await client.open(new File([glb], "dog.glb"), { create: { label: "cat" } });
  assert.equal(other.facts.label, "cat");
  await Promise.all([session.close(), other.close()]);
});
