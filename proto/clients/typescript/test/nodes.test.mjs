/** Several servers with one store: a call that comes to the wrong one goes to the right one, and nobody is sent around for ever. */

import assert from "node:assert/strict";
import http from "node:http";
import { after, before, test } from "node:test";
import { Client, PliantError } from "../dist/index.js";
import { Places } from "../dist/places.js";
import { skip, start } from "./server.mjs";

const FEET = { id: "feet", region: { region: { case: "halfSpace", value: { normal: [0, -1, 0], offset: -0.14 } } } };
const HEAD = { id: "head", region: { region: { case: "sphere", value: { center: [0.76, 1.22, 0], radius: 0.36 } } } };
const nod = (angle) => [{ id: "head", pose: { rotationVector: [0, 0, angle] } }];

/** A node that has no session at all, and knows who has: it says so to every call. */
async function wrongNode(owner) {
  const node = { owner, seen: [] };
  const server = http.createServer((request, response) => {
    node.seen.push({ method: request.method, url: request.url, ...request.headers });
    request.resume();
    const problem = { code: "UNAVAILABLE", detail: "the session is at another node" };
    const headers = { "content-type": "application/problem+json", "x-pliant-owner": node.owner, "x-pliant-node": "b", "retry-after": "1" };
    response.writeHead(503, headers).end(JSON.stringify(problem));
  });
  server.on("upgrade", (request, socket) => {
    node.seen.push({ method: "UPGRADE", url: request.url });
    socket.end(`HTTP/1.1 307 Temporary Redirect\r\nlocation: ${node.owner}${request.url}\r\ncontent-length: 0\r\n\r\n`);
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  node.url = `http://127.0.0.1:${server.address().port}`;
  node.stop = () => server.close();
  return node;
}

let real;
let wrong;

before(async () => {
  if (skip) return;
  real = await start();
  wrong = await wrongNode(real.url);
});

after(() => {
  real?.stop();
  wrong?.stop();
});

test("calls and streams go to the node that has the session", { skip }, async () => {
  const session = await new Client({ url: wrong.url }).sample();
  assert.equal(wrong.seen[0]["x-pliant-hops"], "0", "who goes there by itself says so");
  await session.setHandles({ handles: [FEET, HEAD] });
  const asked = wrong.seen.length;
  const solved = await session.solve(nod(0.3));
  assert.deepEqual(await session.positions(), solved.positions);
  assert.equal(wrong.seen.length, asked, "who knows where it is does not ask again");

  const attached = await new Client({ url: wrong.url }).session(session.id);
  const stream = attached.stream();
  assert.ok((await stream.commit(nod(0.5))).final);
  stream.close();
  assert.equal(wrong.seen.filter(({ method }) => method === "UPGRADE").length, 0);
  await session.close();
});

test("a stream finds its node though its first socket came to the wrong one", { skip }, async () => {
  const session = await new Client({ url: real.url }).sample();
  await session.setHandles({ handles: [FEET, HEAD] });
  // This client has never asked for the session: its socket is refused, and the session is asked for then.
  const fresh = new Client({ url: wrong.url });
  const { Session } = await import("../dist/session.js");
  const stream = new Session(fresh.transport, session.facts).stream();
  assert.ok((await stream.commit(nod(0.2))).final);
  assert.equal(wrong.seen.filter(({ method }) => method === "UPGRADE").length, 1);
  stream.close();
  await session.close();
});

test("who is sent around in circles gives up", async () => {
  const one = await wrongNode("");
  const other = await wrongNode(one.url);
  one.owner = other.url;
  const begun = Date.now();
  await assert.rejects(new Client({ url: one.url, patience: 1.5 }).session("0".repeat(32)), (error) => {
    return error instanceof PliantError && error.code === "UNAVAILABLE";
  });
  assert.ok(Date.now() - begun < 10_000);
  assert.ok(one.seen.length + other.seen.length < 40, "with pauses");
  assert.ok(other.seen.every((seen) => seen["x-pliant-node"] === "b"), "a proxy learns the node's name");
  one.stop();
  other.stop();
});

test("what was to be encrypted is not sent into the open, and only so much is remembered", () => {
  const places = new Places("https://mesh.example");
  const told = (owner) => places.told(503, (name) => ({ "x-pliant-owner": owner, "x-pliant-node": "b" })[name] ?? null);
  assert.equal(told("http://10.0.0.5:7411"), undefined);
  assert.deepEqual(told("https://10.0.0.5:7411/"), { url: "https://10.0.0.5:7411", node: "b" });
  for (let k = 0; k < 1001; k++) places.remember(`/v1/sessions/${k}/solve`, told("https://10.0.0.5:7411"));
  assert.equal(places.of("/v1/sessions/0").url, "https://mesh.example");
  assert.equal(places.of("/v1/sessions/1000/positions").node, "b");
  assert.equal(places.of("/v1/sessions").url, "https://mesh.example");
});
