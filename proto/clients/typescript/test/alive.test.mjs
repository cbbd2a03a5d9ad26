/** Servers that stand still, and say nothing of it: they are noticed, and those that only work for long are waited for. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { Stream } from "../dist/index.js";
import { SIGN_OF_LIFE_MS, SILENCE_MS, whileAlive } from "../dist/alive.js";
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

test("a call is waited for while its server gives signs of life, and no longer", async (t) => {
  t.mock.timers.enable(APIS);
  const server = still();
  let failure;
  whileAlive(server.fetch, ["http://a/v1/sessions/s", {}], ["http://a/v1/limits", {}]).catch((error) => (failure = error));
  await pass(t.mock.timers, 20 * SILENCE_MS);
  assert.equal(failure, undefined);
  assert.ok(server.asked.length > 15, `${server.asked.length}`);
  server.lives = false;
  await pass(t.mock.timers, SILENCE_MS + SIGN_OF_LIFE_MS);
  assert.match(`${failure}`, /no sign of life/);
  const asked = server.asked.length;
  await pass(t.mock.timers, 10 * SILENCE_MS);
  assert.equal(server.asked.length, asked, "nobody is asked after the end");
});

test("a call that is answered asks for nothing", async (t) => {
  t.mock.timers.enable(APIS);
  const asked = [];
  const fetch = (url) => (asked.push(url), Promise.resolve(new Response("{}")));
  assert.equal((await whileAlive(fetch, ["http://a/b", {}], ["http://a/v1/limits", {}])).status, 200);
  await pass(t.mock.timers, 10 * SILENCE_MS);
  assert.deepEqual(asked, ["http://a/b"]);
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
