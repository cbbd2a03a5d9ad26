import assert from "node:assert/strict";
import { test } from "node:test";
import { PliantError, Stream } from "../dist/index.js";
import { FakeSocket, frame, settled } from "./fake.mjs";

/** A stream whose sockets and session the test plays. */
function staged(events = {}) {
  const sockets = [];
  const stage = { sockets, revision: 1n, known: 1, failure: undefined, states: [] };
  const route = {
    connect: () => {
      const socket = new FakeSocket();
      sockets.push(socket);
      return socket;
    },
    probe: async () => {
      if (stage.failure !== undefined) throw stage.failure;
      return { revision: stage.revision };
    },
    known: () => stage.known,
  };
  const onState = (state, reason) => stage.states.push(reason === undefined ? state : `${state}: ${reason.code}`);
  stage.stream = new Stream(route, { tolerance: 1e-3 }, { onState, ...events });
  return stage;
}

async function untilSockets(stage, count) {
  while (stage.sockets.length < count) await new Promise((resolve) => setTimeout(resolve, 10));
  return stage.sockets[count - 1];
}

test("options go first, and only the newest pose of those given before the socket opens", () => {
  const { stream, sockets } = staged();
  stream.pose([{ id: "a" }]);
  stream.pose([{ id: "b" }]);
  sockets[0].open();
  assert.deepEqual(sockets[0].sent.map((message) => message.case), ["options", "pose"]);
  assert.equal(sockets[0].of("pose")[0].handles[0].id, "b");
  stream.close();
});

test("a frame is acknowledged when it is taken, not when it comes", () => {
  let told = 0;
  const { stream, sockets } = staged({ onFrame: () => (told += 1) });
  sockets[0].open();
  stream.pose([{ id: "a" }]);
  sockets[0].say(frame(1, [1, 2, 3]));
  assert.equal(told, 1);
  assert.equal(sockets[0].of("ack").length, 0);
  const target = new Float32Array(3);
  assert.equal(stream.take(target).seq, 1);
  assert.deepEqual([...target], [1, 2, 3]);
  assert.equal(sockets[0].of("ack")[0].seq, 1n);
  assert.equal(stream.take(target), undefined);
  stream.close();
});

test("of whole frames that wait only the last is written; partial ones are laid over it", () => {
  const { stream, sockets } = staged();
  sockets[0].open();
  sockets[0].say(frame(1, [1, 1, 1, 1, 1, 1]));
  sockets[0].say(frame(2, [2, 2, 2, 2, 2, 2]));
  sockets[0].say(frame(3, [3, 3, 3], { indices: [1] }));
  const target = new Float32Array(6);
  assert.equal(stream.take(target).seq, 3);
  assert.deepEqual([...target], [2, 2, 2, 3, 3, 3]);
  assert.deepEqual(sockets[0].of("ack").map(({ seq }) => seq), [3n]);
  stream.close();
});

test("a full socket holds poses back where they can be replaced", async () => {
  const { stream, sockets } = staged();
  sockets[0].open();
  sockets[0].bufferedAmount = 1 << 20;
  stream.pose([{ id: "a" }]);
  stream.pose([{ id: "b" }]);
  assert.equal(sockets[0].of("pose").length, 0);
  sockets[0].bufferedAmount = 0;
  await new Promise((resolve) => setTimeout(resolve, 30));
  assert.deepEqual(sockets[0].of("pose").map((pose) => pose.handles[0].id), ["b"]);
  stream.close();
});

test("a commit answers with its final frame", async () => {
  const { stream, sockets } = staged();
  sockets[0].open();
  const recorded = stream.commit([{ id: "a" }]);
  sockets[0].say(frame(1, [0, 0, 0], { final: false }));
  sockets[0].say(frame(1, [0, 0, 0], { revision: 2n }));
  assert.equal((await recorded).revision, 2);
  assert.ok(sockets[0].of("pose")[0].commit);
  stream.close();
});

test("a refused pose is told, a refused commit rejects, and the stream goes on", async () => {
  const refusals = [];
  const { stream, sockets } = staged({ onPoseError: (error, seq) => refusals.push([seq, error.code]) });
  sockets[0].open();
  const recorded = stream.commit([{ id: "nobody" }]);
  sockets[0].say({ case: "error", value: { code: 3, message: "no handle nobody", seq: 1n } });
  await assert.rejects(recorded, (error) => error instanceof PliantError && error.message === "no handle nobody");
  assert.deepEqual(refusals, [[1, "INVALID_ARGUMENT"]]);
  assert.equal(stream.state, "open");
  stream.close();
});

test("a lost socket is opened again with options and the newest pose", async () => {
  const stage = staged();
  stage.sockets[0].open();
  stage.stream.pose([{ id: "a" }]);
  stage.sockets[0].drop();
  assert.equal(stage.stream.state, "lost");
  stage.stream.pose([{ id: "b" }]);
  const second = await untilSockets(stage, 2);
  second.open();
  assert.deepEqual(second.sent.map((message) => message.case), ["options", "pose"]);
  assert.equal(second.of("pose")[0].handles[0].id, "b");
  assert.equal(stage.stream.totals.reconnects, 1);
  assert.deepEqual(stage.states, ["open", "lost: UNREACHABLE", "open"]);
  stage.stream.close();
});

test("a commit that was lost on the way is sent again", async () => {
  const stage = staged();
  stage.sockets[0].open();
  stage.sockets[0].say(frame(7, [0, 0, 0], { revision: 4n }));
  const recorded = stage.stream.commit([{ id: "a" }]);
  stage.sockets[0].drop();
  stage.revision = 4n;
  const second = await untilSockets(stage, 2);
  second.open();
  const [again] = second.of("pose");
  assert.ok(again.commit);
  second.say(frame(Number(again.seq), [0, 0, 0], { revision: 5n }));
  assert.equal((await recorded).revision, 5);
  stage.stream.close();
});

test("a commit that was stored before the socket went is not made twice", async () => {
  const stage = staged();
  stage.sockets[0].open();
  stage.sockets[0].say(frame(7, [0, 0, 0], { revision: 4n }));
  const recorded = stage.stream.commit([{ id: "a" }]);
  stage.sockets[0].drop();
  stage.revision = 5n;
  const second = await untilSockets(stage, 2);
  second.open();
  const [shown] = second.of("pose");
  assert.equal(shown.commit, false);
  second.say(frame(Number(shown.seq), [0, 0, 0], { revision: 5n }));
  assert.equal((await recorded).revision, 5);
  stage.stream.close();
});

test("of two commits on the way, the one that was stored is not made again and the other is", async () => {
  const stage = staged();
  stage.sockets[0].open();
  const first = stage.stream.commit([{ id: "a" }]);
  const second = stage.stream.commit([{ id: "b" }]);
  stage.sockets[0].drop();
  stage.revision = 2n;
  const socket = await untilSockets(stage, 2);
  socket.open();
  const poses = socket.of("pose");
  assert.deepEqual(poses.map(({ commit, handles }) => [commit, handles[0].id]), [[true, "b"], [false, "a"]]);
  for (const { seq } of poses) socket.say(frame(Number(seq), [0, 0, 0]));
  await Promise.all([first, second]);
  stage.stream.close();
});

test("a revision made beside the stream does not pass for a commit of the stream", async () => {
  const stage = staged();
  stage.sockets[0].open();
  // Handles were set over HTTP.
  stage.known = 3;
  const recorded = stage.stream.commit([{ id: "a" }]);
  stage.sockets[0].drop();
  stage.revision = 3n;
  const second = await untilSockets(stage, 2);
  second.open();
  assert.ok(second.of("pose")[0].commit);
  second.say(frame(1, [0, 0, 0], { revision: 4n }));
  await recorded;
  stage.stream.close();
});

test("a session that is no more ends the stream and its commits", async () => {
  const stage = staged();
  stage.sockets[0].open();
  const recorded = stage.stream.commit([{ id: "a" }]);
  stage.failure = new PliantError("NOT_FOUND", "no session", 404);
  stage.sockets[0].drop();
  await assert.rejects(recorded, /no session/);
  assert.equal(stage.stream.state, "gone");
  await settled();
  assert.equal(stage.sockets.length, 1);
});

test("while the server is away the stream keeps trying, and at once when asked", async () => {
  const stage = staged();
  stage.sockets[0].open();
  stage.failure = new PliantError("UNREACHABLE", "nobody there");
  stage.sockets[0].drop();
  await new Promise((resolve) => setTimeout(resolve, 250));
  assert.equal(stage.stream.state, "lost");
  stage.failure = undefined;
  stage.stream.retry();
  await settled();
  assert.equal(stage.sockets.length, 2);
  stage.stream.close();
});

test("after close nothing is sent and nothing is opened", async () => {
  const stage = staged();
  stage.sockets[0].open();
  stage.stream.close();
  stage.sockets[0].drop();
  await assert.rejects(stage.stream.commit([]), /closed/);
  await new Promise((resolve) => setTimeout(resolve, 150));
  assert.equal(stage.sockets.length, 1);
});
