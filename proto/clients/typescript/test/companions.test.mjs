/** The files that belong to a model: their names, where they are found, and their way through a server. */

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { Client, companionNames, companionsOf } from "../dist/index.js";
import { skip, start } from "./server.mjs";

let client;
let server;

before(async () => {
  if (skip) return;
  server = await start();
  client = new Client({ url: server.url });
});

after(() => server?.stop());

const blob = (...parts) => new Blob(parts);
const bytesOf = async (file) => new Uint8Array(await file.arrayBuffer());
const PICTURE = new Uint8Array([0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 1, 2, 3]);

/** A tetrahedron whose buffer and picture lie outside. */
function tetrahedron() {
  const buffer = new ArrayBuffer(72);
  new Float32Array(buffer, 0, 12).set([0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1]);
  new Uint16Array(buffer, 48, 12).set([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]);
  const document = {
    asset: { version: "2.0" },
    scene: 0,
    scenes: [{ nodes: [0] }],
    nodes: [{ mesh: 0 }],
    meshes: [{ primitives: [{ attributes: { POSITION: 0 }, indices: 1 }] }],
    images: [{ uri: "maps/base%20colour.png" }],
    buffers: [{ byteLength: 72, uri: "./data.bin" }],
    bufferViews: [
      { buffer: 0, byteLength: 48 },
      { buffer: 0, byteOffset: 48, byteLength: 24 },
    ],
    accessors: [
      { bufferView: 0, componentType: 5126, count: 4, type: "VEC3", min: [0, 0, 0], max: [1, 1, 1] },
      { bufferView: 1, componentType: 5123, count: 12, type: "SCALAR" },
    ],
  };
  return { model: blob(JSON.stringify(document)), data: blob(buffer) };
}

test("a document names its files, each once and none outside of its folder", async () => {
  const uris = ["a%20b.bin", "data:application/octet-stream;base64,AA==", "../up.bin", "/abs.bin", "http://x/y.bin", "./c.bin"];
  const document = { buffers: uris.map((uri) => ({ uri })), images: [{ uri: "t/d.png" }, { uri: "a b.bin" }, { bufferView: 0 }] };
  assert.deepEqual(await companionNames(blob(JSON.stringify(document))), ["a b.bin", "c.bin", "t/d.png"]);
  const json = new TextEncoder().encode(JSON.stringify(document).padEnd(512));
  const header = new Uint32Array([0x46546c67, 2, 532, json.length, 0x4e4f534a]);
  assert.deepEqual(await companionNames(blob(header, json)), ["a b.bin", "c.bin", "t/d.png"]);
  for (const other of ["v 0 0 0\n", "mtllib\n", "{", '{"buffers": 3}', '{"images": [null, 4]}', ""]) {
    assert.deepEqual(await companionNames(blob(other)), []);
  }
});

test("files are found below the model's folder, and by their name alone where only one has it", async () => {
  const { model } = tetrahedron();
  const at = (path, text) => ({ path, file: blob(text) });
  const others = [at("car/maps/base colour.png", "right"), at("bike/maps/base colour.png", "wrong"), at("data.bin", "loose")];
  const found = await companionsOf({ path: "car/car.gltf", file: model }, others);
  assert.deepEqual([...found.keys()], ["data.bin", "maps/base colour.png"]);
  assert.equal(await found.get("maps/base colour.png").text(), "right");
  const unsure = await companionsOf({ path: "plane/plane.gltf", file: model }, others);
  assert.deepEqual([...unsure.keys()], ["data.bin"]);
});

test("a library of an OBJ and its pictures are found", async () => {
  const model = { path: "m/m.obj", file: blob("mtllib my things.mtl\nv 0 0 0\n") };
  const library = "newmtl a\nmap_Kd -s 1 1 1 -clamp on maps\\red paint.png\nmap_d ../secret.png\nnorm n.png\n";
  const others = ["my things.mtl", "maps/red paint.png", "n.png", "secret.png"].map((name) => ({
    path: `m/${name}`,
    file: blob(name.endsWith(".mtl") ? library : name),
  }));
  const found = await companionsOf(model, others);
  assert.deepEqual([...found.keys()], ["my things.mtl", "maps/red paint.png", "n.png"]);
});

test("buffers and pictures travel and come back", { skip }, async () => {
  const { model, data } = tetrahedron();
  const others = [{ path: "data.bin", file: data }, { path: "maps/base colour.png", file: blob(PICTURE) }];
  const companions = await companionsOf({ path: "t.gltf", file: model }, others);
  const session = await client.open(model, { companions });
  const files = await session.files();
  assert.deepEqual([...files.keys()].sort(), ["", "data.bin", "maps/base colour.png"]);
  assert.deepEqual(await bytesOf(files.get("")), await bytesOf(model));
  assert.deepEqual(await bytesOf(files.get("data.bin")), await bytesOf(data));
  assert.deepEqual(await bytesOf(files.get("maps/base colour.png")), PICTURE);
  const alone = await session.files("glb");
  assert.deepEqual([...alone.keys()], [""]);
  assert.deepEqual(await companionNames(alone.get("")), []);
  const glb = Buffer.from(await alone.get("").arrayBuffer());
  assert.ok(glb.includes(PICTURE), "the picture is in the file");
  await session.close();
});
