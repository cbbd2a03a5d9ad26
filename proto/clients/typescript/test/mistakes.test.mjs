/** What people get wrong is told with its place and what is allowed, before anything is sent. */

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { cpSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { inspect } from "node:util";
import { fileURLToPath } from "node:url";
import { Client, Session, Stream, regionFrom } from "../dist/index.js";
import { FakeSocket } from "./fake.mjs";

const says = (pattern) => (error) => {
  assert.equal(error.name, "PliantError");
  assert.equal(error.code, "INVALID_ARGUMENT");
  assert.match(error.message, pattern);
  return true;
};

test("an address without its scheme is refused", () => {
  for (const url of ["127.0.0.1:7431", "localhost:7411", "ftp://host", ""]) {
    assert.throws(() => new Client({ url }), says(/^url: ".*" does not begin with http:\/\/ or https:\/\/.*such as http:\/\/127\.0\.0\.1:7411$/));
  }
  assert.throws(() => new Client({ url: "http://" }), says(/"http:\/\/" is not an address/));
  assert.equal(new Client({ url: "HTTP://host:1//" }).transport.url, "HTTP://host:1");
});

test("a key that is misspelt is named, with those that are allowed", () => {
  assert.throws(() => regionFrom({ sphere: { centre: [0, 1, 0], radius: 1 } }), says(/^region: sphere: centre is not a key of it; allowed are center \(three numbers\) and radius \(a number\)$/));
  assert.throws(() => regionFrom({ sphere: { center: [0, 1, 0] } }), says(/sphere: radius is missing/));
  assert.throws(() => regionFrom({ box: { min: [0, 1], max: [1, 1, 1] } }), says(/box: min is \[0,1\], it takes three numbers/));
  assert.throws(() => regionFrom({ halfSpace: { normal: [0, 1, 0], offset: "0" } }), says(/offset is "0", it takes a number/));
  assert.throws(() => regionFrom({ sphere: 3 }), says(/sphere: is 3, an object/));
  assert.throws(() => regionFrom({ tube: { points: [[0, 0], [1, 1, 1]], radius: 1 } }), says(/points is .*, it takes a list of points/));
});

test("vectors of other libraries are points", () => {
  const vector = { *[Symbol.iterator]() { yield* [1, 2, 3]; } };
  assert.deepEqual(regionFrom({ sphere: { center: vector, radius: 1 } }).region.value.center, [1, 2, 3]);
  assert.deepEqual(regionFrom({ tube: { points: [0, 0, 0, 1, 1, 1], radius: 1 } }).region.value.points, [0, 0, 0, 1, 1, 1]);
});

test("a pose that is none is told with its handle and field", async () => {
  const socket = new FakeSocket();
  const stream = new Stream({ connect: () => socket, probe: async () => undefined, known: () => 0 }, {}, {}, 1);
  const wrong = [
    [{ translation: "up" }, /^handle "head": pose\.translation is "up", a list of 3 numbers is allowed$/],
    [{ rotation: [0, 0, 1] }, /pose\.rotation is \[0,0,1\], a list of 4 numbers/],
    [{ scale: [1, 2] }, /pose\.scale is \[1,2\], a list of 1 or 3 numbers/],
    [{ translate: [0, 0, 1] }, /translate is not a field of it; allowed are translation, rotation, rotationVector, scale, pivot, freeRotation/],
    [{ freeRotation: 1 }, /pose\.freeRotation is 1, true or false is allowed/],
    ["up", /pose is "up", an object/],
  ];
  for (const [pose, pattern] of wrong) {
    assert.throws(() => stream.pose([{ id: "head", pose }]), says(pattern));
    await assert.rejects(stream.commit([{ id: "head", pose }]), says(pattern));
  }
  stream.pose([{ id: "head", pose: { translation: [0, 1, 0], scale: [2] } }, { id: "feet" }]);
  stream.pose([{ id: "head", pose: { translation: [0, 1, 0], freeRotation: true } }]);
  stream.close();
});

test("what is given in place of a model, or of a list of poses, is refused", async () => {
  const client = new Client({ url: "http://127.0.0.1:9" });
  await assert.rejects(client.open("creature.glb"), says(/^model: "creature\.glb" is a string; a File or a Blob is allowed; in node, new Blob/));
  const socket = new FakeSocket();
  const stream = new Stream({ connect: () => socket, probe: async () => undefined, known: () => 0 }, {}, {}, 1);
  assert.throws(() => stream.pose({ head: { translation: [0, 1, 0] } }), says(/^poses: \{"head".*, a list such as \[\{ id: "head"/));
  stream.close();
});

test("a client and its session are logged in a line, without the token", () => {
  const client = new Client({ url: "http://host:1", token: "secret", headers: { "x-key": "secret" } });
  const session = new Session(client.transport, { id: "abc", label: "cup.glb", revision: 3n, model: { vertices: 8 } });
  assert.equal(inspect(client), "Client of http://host:1");
  assert.equal(inspect(session), 'Session "cup.glb" abc: 8 vertices, revision 3');
  for (const written of [inspect({ client }), JSON.stringify(client), String(session), inspect(client.transport)]) {
    assert.doesNotMatch(written, /secret/);
  }
});

test("a page of another origin is told of cors_origins, one of the server's own is not", async () => {
  const fetch = () => Promise.reject(new TypeError("Failed to fetch"));
  const ask = (url) => new Client({ url, fetch }).limits().then(() => "", ({ code, message }) => `${code} ${message}`);
  assert.equal(await ask("http://mesh.test:7411"), "UNREACHABLE http://mesh.test:7411 does not answer", "node knows no origins");
  globalThis.window = { location: { origin: "https://shop.test" } };
  try {
    assert.match(await ask("http://mesh.test:7411"), /does not answer; if it runs, it may not answer pages of https:\/\/shop\.test: name that host in its cors_origins$/);
    assert.equal(await ask("https://shop.test/pliant"), "UNREACHABLE https://shop.test/pliant does not answer");
  } finally {
    delete globalThis.window;
  }
});

test("a process without a WebSocket is told how to get one, and ends", (t) => {
  // Where no `ws` is installed.
  const folder = mkdtempSync(join(tmpdir(), "pliant-"));
  t.after(() => rmSync(folder, { recursive: true, force: true }));
  const here = fileURLToPath(new URL("..", import.meta.url));
  cpSync(join(here, "dist"), join(folder, "dist"), { recursive: true });
  cpSync(join(here, "node_modules/@bufbuild/protobuf"), join(folder, "node_modules/@bufbuild/protobuf"), { recursive: true });
  writeFileSync(join(folder, "package.json"), '{"type": "module"}');
  const program = `
    import { Client, Stream } from "./dist/index.js";
    const { transport } = new Client({ url: "http://127.0.0.1:9" });
    try {
      new Stream({ connect: () => transport.socket("/stream"), probe: async () => undefined, known: () => 0 }, {}, {}, 1);
    } catch ({ code, message }) {
      console.log(code, message);
    }`;
  const flags = process.allowedNodeEnvironmentFlags.has("--no-experimental-websocket") ? ["--no-experimental-websocket"] : [];
  const options = { cwd: folder, encoding: "utf8", timeout: 60_000, env: { ...process.env, NODE_OPTIONS: "" } };
  const { signal, status, stdout, stderr } = spawnSync(process.execPath, [...flags, "--input-type=module", "-e", program], options);
  assert.deepEqual([signal, status], [null, 0], stderr);
  assert.match(stdout, /^UNIMPLEMENTED there is no WebSocket here; node 22 has one, node 20 takes that of `npm install ws`, .* `new Client\(\{ WebSocket \}\)`/);
});
