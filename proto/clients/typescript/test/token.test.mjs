/** Who asks: a token with every call and WebSocket, asked for once where there is none. */

import assert from "node:assert/strict";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { Client } from "../dist/index.js";
import { newToken, skipOwn as skip, start } from "./server.mjs";

let folder;
let server;
let token;

before(async () => {
  if (skip) return;
  folder = mkdtempSync(join(tmpdir(), "pliant-"));
  const made = newToken("studio");
  token = made.token;
  const config = join(folder, "pliant.toml");
  writeFileSync(config, made.lines);
  server = await start("--config", config);
});

after(() => {
  server?.stop();
  if (folder !== undefined) rmSync(folder, { recursive: true });
});

test("calls and streams carry the token", { skip }, async () => {
  const client = new Client({ url: server.url, token });
  const session = await client.sample();
  await session.setHandles({
    handles: [{ id: "head", region: { region: { case: "sphere", value: { center: [0.76, 1.22, 0], radius: 0.36 } } } }],
  });
  const stream = session.stream();
  const frame = await stream.commit([{ id: "head", pose: { rotationVector: [0, 0, -0.4] } }]);
  assert.ok(frame.final);
  stream.close();
  await session.close();
});

test("a server that wants to know is told after it asked, once for all calls that wait", { skip }, async () => {
  const told = [];
  const answers = ["pliant_of-another-server", token];
  const askToken = async (refused) => {
    told.push(refused);
    await new Promise((resolve) => setTimeout(resolve, 50));
    return answers.shift();
  };
  const client = new Client({ url: server.url, askToken });
  const limits = await Promise.all([client.limits(), client.limits(), client.limits()]);
  assert.ok(limits.every(({ vertices }) => vertices > 0n));
  assert.deepEqual(told, [false, true]);
  await client.limits();
  assert.equal(told.length, 2);
});

test("without a token a call fails with what the server says", { skip }, async () => {
  for (const options of [{}, { token: "pliant_of-another-server" }, { askToken: async () => undefined }]) {
    const call = new Client({ url: server.url, ...options }).limits();
    await assert.rejects(call, { code: "UNAUTHENTICATED", message: /token/ });
  }
});

test("the environment may hold the token", { skip }, async () => {
  process.env.PLIANT_TOKEN = token;
  try {
    assert.ok((await new Client({ url: server.url }).limits()).vertices > 0n);
  } finally {
    delete process.env.PLIANT_TOKEN;
  }
});
