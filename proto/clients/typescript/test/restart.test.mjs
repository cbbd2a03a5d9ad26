/** A server that is started again under its clients, politely and not: drags go on, and every commit is recorded once. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { Client, PliantError } from "../dist/index.js";
import { skipOwn, startKept } from "./server.mjs";

const FEET = { id: "feet", region: { region: { case: "halfSpace", value: { normal: [0, -1, 0], offset: -0.14 } } } };
const HEAD = { id: "head", region: { region: { case: "sphere", value: { center: [0.76, 1.22, 0], radius: 0.36 } } } };
const nod = (angle) => [{ id: "head", pose: { rotationVector: [0, 0, angle] } }];
const tick = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

async function until(what, holds) {
  for (let k = 0; !holds(); k++) {
    assert.ok(k < 3000, what);
    await tick(10);
  }
}

for (const [signal, code] of [
  ["SIGTERM", 0],
  ["SIGKILL", "SIGKILL"],
]) {
  test(`a drag goes on while its server is ended by ${signal} and started again`, { skip: skipOwn }, async () => {
    // Far more time than it takes: a server that waited for its clients to be cut would need all of it.
    const server = await startKept("--drain-deadline", "300s");
    try {
      const session = await new Client({ url: server.url }).sample();
      await session.setHandles({ handles: [FEET, HEAD] });
      const positions = await session.positions();
      const states = [];
      const refusals = [];
      let newest = 0;
      const stream = session.stream({}, {
        onState: (state) => states.push(state),
        onPoseError: (error) => refusals.push(error.message),
        onFrame: ({ seq, final }) => {
          stream.take(positions);
          if (final) newest = seq;
        },
      });
      const commits = [];
      let angle = 0;
      const drag = async (poses) => {
        for (let k = 0; k < poses; k++) {
          stream.pose(nod((angle -= 0.005)));
          if (k % 5 === 4) commits.push(stream.commit(nod(angle)));
          await tick(8);
        }
      };
      await drag(20);
      const ended = server.restart(signal);
      await drag(40);
      assert.equal(await ended, code, "the server ended well, and not because its time was over");
      await drag(20);
      const last = stream.pose(nod(-0.5));
      await until("the newest pose is answered", () => newest === last);

      const frames = await Promise.all(commits);
      const { commits: kept } = await session.history();
      const poses = kept.filter(({ kind }) => kind === "pose").map(({ revision }) => Number(revision));
      assert.deepEqual(poses, frames.map(({ revision }) => revision), "every commit is recorded once, in order");
      assert.deepEqual(refusals, []);
      assert.ok(stream.totals.reconnects >= 1);
      // It is told anew with every attempt that fails, and how many do depends on the server's start.
      const changes = states.filter((state, k) => state !== states[k - 1]);
      assert.deepEqual(changes.slice(0, 3), ["open", "lost", "open"]);
      const final = await stream.commit(nod(-0.5));
      assert.equal(final.revision, poses.at(-1) + 1);
      assert.deepEqual(positions, await session.positions());
      stream.close();
      await session.close();
    } finally {
      await server.stop();
    }
  });
}

test("calls wait for a server that is started again, and happen once", { skip: skipOwn }, async () => {
  const server = await startKept("--drain-deadline", "2s");
  try {
    const session = await new Client({ url: server.url }).sample();
    await session.setHandles({ handles: [FEET, HEAD] });
    for (const signal of ["SIGTERM", "SIGKILL"]) {
      const ended = server.restart(signal);
      for (let k = 1; k <= 3; k++) await session.solve(nod(-0.1 * k));
      await session.undo();
      await ended;
    }
    const { commits } = await session.history();
    const poses = Array(5).fill("pose");
    assert.deepEqual(commits.map(({ kind }) => kind), ["create", "handles", ...poses], "two of the first round, three of the second");
    await session.close();
    await session.close().then(
      () => assert.fail("it is gone"),
      (error) => assert.ok(error instanceof PliantError && error.isGone),
    );
  } finally {
    await server.stop();
  }
});

test("a server that does not come back is told with how long it was looked for", { skip: skipOwn }, async () => {
  const server = await startKept();
  try {
    const client = new Client({ url: server.url, patience: 0.3 });
    const session = await client.sample();
    await session.setHandles({ handles: [FEET, HEAD] });
    let ended;
    const stream = session.stream({}, { onState: (state, reason) => (ended = state === "closed" ? reason : ended) }, { patience: 0.3 });
    await stream.commit(nod(-0.1));
    await server.end("SIGKILL");
    const lost = (error) => error instanceof PliantError && /tried again for 0\.3 s/.test(error.message);
    await assert.rejects(session.solve(nod(-0.2)), lost);
    await until("the stream ends", () => ended !== undefined);
    assert.ok(lost(ended), `${ended}`);
    await assert.rejects(stream.commit(nod(-0.2)), /closed/);
    await assert.rejects(new Client({ url: "http://127.0.0.1:9" }).limits(), /does not answer$/, "who was never there is not waited for");
  } finally {
    await server.stop();
  }
});
