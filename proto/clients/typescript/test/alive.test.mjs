/** Servers that stand still, and say nothing of it: they are noticed, and those that only work for long are waited for. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { Stream } from "../dist/index.js";
import { SIGN_OF_LIFE_MS, SILENCE_MS } from "../dist/alive.js";
import { Transport } from "../dist/transport.js";
import { FakeSocket } from "./fake.mjs";

/** A socket that fails as soon as it is closed before it was open, as those of node do. */
class HastySocket extends FakeSocket {
  close() {
    const wasOpen = this.readyState === 1;
    super.close();
    if (!wasOpen) this.onerror?.();
  }
}

/** Lets promises run between two steps of a clock that the test holds. */
async function pass(clock, milliseconds) {
  for (let gone = 0; gone < milliseconds; gone += 500) {
    clock.tick(500);
    await new Promise((resolve) => setImmediate(resolve));
  }
}

const APIS = { apis: ["setInterval", "setTimeout", "Date"] };

/** A server that never answers what it is asked, but for signs of life while it has any. */
function still() {
  const server = { lives: true, asked: [] };
  server.fetch = (url, { signal }) => {
    server.asked.push(url);
    if (url.endsWith("/v1/limits") && server.lives) return Promise.resolve(new Response("{}"));
    return new Promise((_, reject) => signal.addEventListener("abort", () => reject(signal.reason), { once: true }));
  };
  return server;
}

const client = (server, more = {}) => new Transport({ url: "http://a", fetch: server.fetch, ...more });
const ask = (transport, call = {}) => transport.read("GET", "/v1/sessions/s/positions", "*/*", call, (answer) => answer.text());

test("a call is waited for while its server gives signs of life, and no longer", async (t) => {
  t.mock.timers.enable(APIS);
  const server = still();
  let failure;
  ask(client(server)).catch((error) => (failure = error));
  await pass(t.mock.timers, 20 * SILENCE_MS);
  assert.equal(failure, undefined);
  assert.ok(server.asked.length > 15, `${server.asked.length}`);
  server.lives = false;
  await pass(t.mock.timers, SILENCE_MS + SIGN_OF_LIFE_MS);
  assert.deepEqual([failure?.code, failure?.message], ["UNREACHABLE", "the server did not answer for 6 s"]);
  const asked = server.asked.length;
  await pass(t.mock.timers, 10 * SILENCE_MS);
  assert.equal(server.asked.length, asked, "nobody is asked after the end");
});

test("an answer whose rest does not come is given up as well, and asked for again where the server goes on", async (t) => {
  t.mock.timers.enable(APIS);
  const server = still();
  server.lives = false;
  const { fetch } = server;
  let calls = 0;
  server.fetch = (url, init) => {
    if (url.endsWith("/v1/limits")) return fetch(url, init);
    calls += 1;
    // The first one stops in the middle: what it holds never ends.
    return Promise.resolve(new Response(calls === 1 ? new ReadableStream({}) : "whole"));
  };
  let answer;
  ask(client(server)).then((text) => (answer = text));
  await pass(t.mock.timers, SILENCE_MS + SIGN_OF_LIFE_MS + 2_000);
  assert.deepEqual([answer, calls], ["whole", 2]);
});

test("how long a call may take, and how long a server may be silent, is the client's to say", async (t) => {
  t.mock.timers.enable(APIS);
  const server = still();
  const failures = {};
  const fails = (name, promise) => promise.catch((error) => (failures[name] = error.message));
  fails("usual", ask(client(server)));
  fails("client", ask(client(server, { timeout: 20 })));
  fails("call", ask(client(server), { timeout: 30 }));
  fails("without end", ask(client(server, { timeout: 0 })));
  await pass(t.mock.timers, 31_000);
  assert.deepEqual(failures, { client: "no answer within 20 s", call: "no answer within 30 s" });
  await pass(t.mock.timers, 600_000);
  assert.equal(failures.usual, "no answer within 600 s");
  server.lives = false;
  fails("short", ask(client(server, { signOfLife: 1 })));
  fails("no sign", ask(client(server, { signOfLife: 0 })));
  await pass(t.mock.timers, SILENCE_MS + SIGN_OF_LIFE_MS + 1_000);
  assert.equal(failures.short, "the server did not answer for 1 s");
  assert.match(failures["without end"], /the server did not answer/);
  assert.equal(failures["no sign"], undefined);
  for (const wrong of [-1, Number.NaN, 1e9]) {
    assert.throws(() => client(server, { timeout: wrong }), /timeout: .*a number of seconds from 0/);
  }
});

test("a page whose connections are all in use asks for no sign, which would wait for them", async (t) => {
  t.mock.timers.enable(APIS);
  globalThis.document = {};
  t.after(() => delete globalThis.document);
  const server = still();
  server.lives = false;
  const transport = client(server);
  const failures = [];
  const stop = new AbortController();
  for (let k = 0; k < 6; k++) ask(transport, { signal: stop.signal }).catch((error) => failures.push(error));
  await pass(t.mock.timers, 60_000);
  assert.deepEqual([failures.length, server.asked.length], [0, 6]);
  stop.abort();
  await pass(t.mock.timers, 500);
  assert.equal(failures.length, 6);
});

test("a call that is answered asks for nothing, and its caller may stop it", async (t) => {
  t.mock.timers.enable(APIS);
  const asked = [];
  const fetch = (url) => (asked.push(url), Promise.resolve(new Response("{}")));
  assert.equal(await ask(client({ fetch })), "{}");
  await pass(t.mock.timers, 10 * SILENCE_MS);
  assert.deepEqual(asked, ["http://a/v1/sessions/s/positions"]);
  const stop = new AbortController();
  const stopped = ask(client(still()), { signal: stop.signal });
  stop.abort();
  await assert.rejects(stopped, { name: "AbortError" });
});

test("a stream leaves a socket that says nothing, and one that does not open, and asks its way past a server that stands still", async (t) => {
  t.mock.timers.enable(APIS);
  const server = still();
  server.lives = false;
  const transport = new Transport({ url: "http://a", fetch: server.fetch });
  const sockets = [];
  const states = [];
  let probe = () => Promise.resolve({ revision: 1n });
  const route = {
    connect: () => (sockets.push(new HastySocket()), sockets.at(-1)),
    probe: () => probe(),
    known: () => 1,
  };
  const stream = new Stream(route, {}, { onState: (state) => states.push(state) }, 600);
  sockets[0].open();
  await pass(t.mock.timers, SILENCE_MS + 1_500);
  assert.equal(sockets[0].of("ping").length, 1);
  sockets[0].say({ case: "pong", value: { nonce: 1n } });
  await pass(t.mock.timers, SILENCE_MS);
  assert.deepEqual(states, ["open"], "who answers stays");
  await pass(t.mock.timers, SILENCE_MS + SIGN_OF_LIFE_MS);
  assert.equal(states[1], "lost");
  assert.equal(sockets.length, 2);
  // The next one neither opens nor fails; then the session is asked for, and nobody answers that either.
  probe = () => transport.probe(undefined, "/v1/sessions/s");
  await pass(t.mock.timers, 2 * SIGN_OF_LIFE_MS);
  assert.ok(server.asked.length > 0);
  await pass(t.mock.timers, SILENCE_MS + SIGN_OF_LIFE_MS);
  probe = () => Promise.resolve({ revision: 1n });
  await pass(t.mock.timers, 2 * SIGN_OF_LIFE_MS);
  assert.equal(sockets.length, 3);
  sockets[2].open();
  assert.equal(stream.state, "open");
  stream.close();
});
