import assert from "node:assert/strict";
import { test } from "node:test";
import { MeshoptEncoder } from "meshoptimizer/encoder";
import { PliantError, Stream } from "../dist/index.js";
import { FakeSocket, frame, settled, toldFrame } from "./fake.mjs";

/** A stream whose sockets and session the test plays. */
function staged(events = {}, patience = 60) {
  const sockets = [];
  const stage = { sockets, revision: 1n, known: 1, failure: undefined, states: [] };
  const route = {
    connect: () => {
      const socket = new FakeSocket();
      sockets.push(socket);
      return socket;
    },
    probe: async () => {
      stage.probed?.();
      if (stage.failure !== undefined) throw stage.failure;
      return { revision: stage.revision };
    },
    known: () => stage.known,
  };
  const onState = (state, reason) => stage.states.push(reason === undefined ? state : `${state}: ${reason.code}`);
  stage.stream = new Stream(route, { tolerance: 1e-3 }, { onState, ...events }, patience);
  return stage;
}

async function untilSockets(stage, count) {
  while (stage.sockets.length < count) await new Promise((resolve) => setTimeout(resolve, 10));
  return stage.sockets[count - 1];
}

/** The handles of a pose and where they are along x. */
const placed = ({ handles }) => handles.map(({ id, pose }) => `${id} ${pose?.translation[0] ?? 0}`);
const at = (id, x) => ({ id, pose: { translation: [x, 0, 0] } });

test("options go first, then one pose with the newest of every handle that was moved before the socket opened", () => {
  const { stream, sockets } = staged();
  stream.pose([at("a", 1)]);
  stream.pose([at("a", 2), at("b", 3)]);
  stream.pose([at("b", 4)]);
  sockets[0].open();
  assert.deepEqual(sockets[0].sent.map((message) => message.case), ["options", "pose"]);
  assert.deepEqual(placed(sockets[0].of("pose")[0]), ["a 2", "b 4"]);
  stream.pose([at("b", 5)]);
  assert.deepEqual(placed(sockets[0].of("pose")[1]), ["b 5"], "later ones say what changes");
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
  assert.deepEqual(sockets[0].of("pose").map((pose) => pose.handles.map(({ id }) => id)), [["a", "b"]]);
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

test("what a refused pose moved is not part of the next commit, and what was accepted before is", async () => {
  const { stream, sockets } = staged();
  sockets[0].open();
  stream.pose([at("a", 1)]);
  sockets[0].say(frame(1, [0, 0, 0]));
  stream.pose([at("a", 2), at("nose", 1)]);
  sockets[0].say({ case: "error", value: { code: 3, message: "no handle nose", seq: 2n } });
  stream.pose([at("b", 3)]);
  sockets[0].say(frame(3, [0, 0, 0]));
  stream.commit([at("c", 4)]).catch(() => {});
  const commit = sockets[0].of("pose").find(({ commit }) => commit);
  assert.deepEqual(placed(commit), ["a 1", "b 3", "c 4"]);
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
  assert.deepEqual(placed(second.of("pose")[0]), ["a 0", "b 0"], "the server has forgotten what was dragged");
  assert.equal(stage.stream.totals.reconnects, 1);
  assert.deepEqual(stage.states, ["open", "lost: UNREACHABLE", "open"]);
  stage.stream.close();
});

test("differences are told anew on a socket that is opened again, and what they lack is never guessed", async () => {
  await MeshoptEncoder.ready;
  const stage = staged();
  const [first, second, third] = [7, 9, 65535].map((x) => Uint16Array.from([x, 1, 2, 0]));
  const target = new Float32Array(3);
  const shown = () => stage.stream.take(target) && [...target];
  stage.sockets[0].open();
  stage.sockets[0].say(toldFrame(1, 1, first));
  stage.sockets[0].say(toldFrame(2, 2, second, first));
  stage.sockets[0].say(toldFrame(3, 3, third, second));
  assert.deepEqual(shown(), [65535, 1, 2], "also of frames that nobody looked at");
  stage.sockets[0].drop();
  const again = await untilSockets(stage, 2);
  again.open();
  again.say(toldFrame(4, 4, first, third));
  assert.equal(stage.stream.hasFrame, false);
  again.drop();
  assert.equal(stage.states.at(-1), "lost: DATA_LOSS");
  const last = await untilSockets(stage, 3);
  last.open();
  last.say(toldFrame(5, 1, second));
  last.say(toldFrame(6, 2, first, second));
  assert.deepEqual(shown(), [7, 1, 2]);
  stage.stream.close();
});

test("a frame that cannot be read is asked for once more, and then the stream ends with what was wrong", async () => {
  await MeshoptEncoder.ready;
  const stage = staged();
  const [first, second] = [7, 9].map((x) => Uint16Array.from([x, 1, 2, 0]));
  const loses = (socket) => {
    socket.open();
    socket.say({ case: "pong", value: { nonce: 1n } });
    socket.say(toldFrame(1, 1, first));
    socket.say(toldFrame(3, 3, second, first));
    // What still comes is of a socket that is left.
    socket.say(toldFrame(1, 1, first));
    socket.drop();
  };
  loses(stage.sockets[0]);
  assert.equal(stage.stream.state, "lost");
  // Two frames that were read: the next failure is the first again.
  const again = await untilSockets(stage, 2);
  again.open();
  again.say(toldFrame(1, 1, first));
  again.say(toldFrame(2, 2, second, first));
  again.say(toldFrame(4, 4, second, first));
  again.drop();
  loses(await untilSockets(stage, 3));
  assert.equal(stage.states.at(-1), "closed: DATA_LOSS");
  await new Promise((resolve) => setTimeout(resolve, 300));
  assert.equal(stage.sockets.length, 3);
});

test("a socket that opens and says nothing does not give the patience anew", async () => {
  const stage = staged({}, 0.3);
  const start = Date.now();
  for (let k = 1; stage.stream.state !== "closed"; k++) {
    assert.ok(Date.now() - start < 5000, "it goes on for ever");
    const socket = stage.sockets[k - 1];
    socket.open();
    socket.drop();
    while (stage.stream.state === "lost" && stage.sockets.length === k) await new Promise((resolve) => setTimeout(resolve, 5));
  }
  assert.match(stage.states.at(-1), /closed: UNREACHABLE/);
});

test("a frame without its facts is never handed out, and one that does not fit a buffer is acknowledged", async () => {
  await MeshoptEncoder.ready;
  const stage = staged();
  const [socket] = stage.sockets;
  socket.open();
  socket.say(frame(1, [1, 2, 3, 4, 5, 6]));
  assert.throws(() => stage.stream.take(new Float32Array(3)), /reaches vertex 1, the buffer holds 1/);
  assert.deepEqual(socket.of("ack").map(({ seq }) => seq), [1n]);
  const bad = toldFrame(2, 1, Uint16Array.from([5, 5, 5, 0]));
  bad.value.boxMin = [];
  socket.say(bad);
  assert.equal(stage.stream.hasFrame, false);
  socket.drop();
  assert.equal(stage.states.at(-1), "lost: DATA_LOSS");
  stage.stream.close();
});

test("what a page does with a frame is not a failure of the socket", () => {
  const stage = staged({
    onFrame: () => {
      throw new Error("the page's own");
    },
  });
  stage.sockets[0].open();
  assert.throws(() => stage.sockets[0].say(frame(1, [1, 2, 3])), /the page's own/);
  assert.equal(stage.stream.state, "open");
  stage.stream.close();
});

test("handles that were dragged are told again with the next pose, when none waits for an answer", async () => {
  const stage = staged();
  stage.sockets[0].open();
  stage.stream.pose([at("a", 1)]);
  stage.sockets[0].say(frame(1, [0, 0, 0]));
  stage.sockets[0].drop();
  const second = await untilSockets(stage, 2);
  second.open();
  assert.equal(second.of("pose").length, 0, "everything is answered");
  stage.stream.pose([at("b", 2)]);
  assert.deepEqual(placed(second.of("pose")[0]), ["a 1", "b 2"]);
  stage.stream.close();
});

test("what others did makes dragged poses void", async () => {
  const stage = staged();
  stage.sockets[0].open();
  stage.stream.pose([at("a", 1)]);
  stage.known = 2;
  stage.stream.pose([at("b", 2)]);
  const recorded = stage.stream.commit([at("b", 3)]);
  assert.deepEqual(placed(stage.sockets[0].of("pose")[2]), ["b 3"], "a call beside the stream");
  stage.sockets[0].say(frame(3, [0, 0, 0], { revision: 3n }));
  await recorded;
  stage.stream.pose([at("a", 4)]);
  stage.sockets[0].say(frame(4, [0, 0, 0], { revision: 9n }));
  stage.stream.commit([at("b", 5)]).catch(() => undefined);
  assert.deepEqual(placed(stage.sockets[0].of("pose")[4]), ["b 5"], "another client");
  stage.stream.close();
});

test("a commit without an answer is sent again with its key, its handles and its options", async () => {
  const stage = staged();
  stage.sockets[0].open();
  stage.stream.pose([at("a", 1)]);
  stage.stream.setOptions({ refine: 7 });
  const recorded = stage.stream.commit([at("b", 2)]);
  stage.stream.setOptions({ refine: 0 });
  const [, first] = stage.sockets[0].of("pose");
  assert.deepEqual(placed(first), ["a 1", "b 2"], "with what was dragged before it");
  stage.sockets[0].drop();
  stage.stream.pose([at("a", 3)]);
  const second = await untilSockets(stage, 2);
  second.open();
  const said = second.sent.map(({ case: kind, value }) => (kind === "options" ? `refine ${value.refine}` : kind));
  assert.deepEqual(said, ["refine 0", "refine 7", "pose", "refine 0", "pose"]);
  const [again, drag] = second.of("pose");
  assert.deepEqual([again.idempotencyKey, again.commit, placed(again)], [first.idempotencyKey, true, placed(first)]);
  assert.match(first.idempotencyKey, /^[0-9a-f]{32}$/);
  assert.deepEqual([drag.idempotencyKey, drag.commit, placed(drag)], ["", false, ["a 3"]]);
  second.say(frame(Number(again.seq), [0, 0, 0], { revision: 5n }));
  assert.equal((await recorded).revision, 5);
  stage.stream.close();
});

test("many commits go out in order and few at a time", async () => {
  const { stream, sockets } = staged();
  const done = [];
  for (let k = 1; k <= 20; k++) stream.commit([at("a", k)]).then(({ seq }) => done.push(seq));
  stream.pose([at("a", 21)]);
  sockets[0].open();
  assert.equal(sockets[0].of("pose").length, 8);
  for (let k = 1; k <= 20; k++) sockets[0].say(frame(k, [0, 0, 0]));
  await settled();
  assert.deepEqual(sockets[0].of("pose").map(({ seq }) => Number(seq)), Array.from({ length: 21 }, (_, k) => k + 1));
  assert.equal(new Set(sockets[0].of("pose").slice(0, 20).map(({ idempotencyKey }) => idempotencyKey)).size, 20);
  assert.deepEqual(done, Array.from({ length: 20 }, (_, k) => k + 1));
  stream.close();
});

test("a server that stops is left when its commits are answered, and what waits goes to the next", async () => {
  const notices = [];
  const stage = staged({ onNotice: (code) => notices.push(code) });
  const [socket] = stage.sockets;
  socket.open();
  const stored = stage.stream.commit([at("a", 1)]);
  const going = { case: "notice", value: { code: "going-away", message: "the server is shutting down", resumeToken: "id" } };
  socket.say(going);
  stage.stream.pose([at("a", 2)]);
  const waiting = stage.stream.commit([at("a", 3)]);
  assert.deepEqual([stage.stream.state, socket.of("pose").length], ["open", 1], "no more for a server that stops");
  socket.say(frame(1, [0, 0, 0], { revision: 2n }));
  await stored;
  assert.deepEqual([socket.readyState, stage.stream.state, notices], [3, "lost", ["going-away"]]);
  const target = new Float32Array(3);
  assert.equal(stage.stream.take(target)?.seq, 1, "the last frame is still shown");
  const second = await untilSockets(stage, 2);
  second.open();
  assert.deepEqual(second.of("pose").map(placed), [["a 3"]]);
  assert.equal(second.of("ack").length, 0, "the next server knows nothing of frames before it");
  second.say(frame(3, [0, 0, 0], { revision: 3n }));
  await waiting;
  assert.deepEqual(stage.states, ["open", "lost: UNAVAILABLE", "open"]);
  stage.stream.close();
});

test("a commit that a stopping server did not come to is made by the next", async () => {
  const stage = staged();
  stage.sockets[0].open();
  const recorded = stage.stream.commit([at("a", 1)]);
  stage.sockets[0].say({ case: "notice", value: { code: "going-away" } });
  stage.sockets[0].say({ case: "error", value: { code: 14, message: "shutting down", seq: 1n } });
  const second = await untilSockets(stage, 2);
  second.open();
  assert.equal(second.of("pose")[0].idempotencyKey, stage.sockets[0].of("pose")[0].idempotencyKey);
  second.say(frame(1, [0, 0, 0], { revision: 2n }));
  await recorded;
  stage.stream.close();
});

test("a commit that a server cannot record now is made on the next socket, in its turn and under its key", async () => {
  const refused = [];
  const stage = staged({ onPoseError: (error) => refused.push(error) });
  const [socket] = stage.sockets;
  socket.open();
  const recorded = stage.stream.commit([at("a", 1)]);
  socket.say({ case: "error", value: { code: 14, message: "the session is at another node", seq: 1n } });
  const behind = stage.stream.commit([at("b", 2)]);
  stage.stream.pose([at("c", 3)]);
  assert.deepEqual(socket.of("pose").map(placed), [["a 1"], ["a 1", "b 2", "c 3"]], "a drag goes on, on top of what waits");
  const second = await untilSockets(stage, 2);
  second.open();
  assert.deepEqual(second.of("pose").map(placed), [["a 1"], ["b 2"], ["c 3"]]);
  assert.equal(second.of("pose")[0].idempotencyKey, socket.of("pose")[0].idempotencyKey);
  socket.say({ case: "error", value: { code: 3, message: "what a socket that was left says", seq: 2n } });
  second.say(frame(1, [0, 0, 0], { revision: 2n }));
  second.say(frame(2, [0, 0, 0], { revision: 3n }));
  assert.equal((await recorded).seq, 1);
  assert.equal((await behind).seq, 2);
  assert.deepEqual([refused, stage.states], [[], ["open", "lost: UNAVAILABLE", "open"]]);
  stage.stream.close();
});

test("a commit that cannot be recorded for longer than the patience fails with what was tried", async () => {
  const stage = staged({}, 0);
  stage.sockets[0].open();
  const recorded = stage.stream.commit([at("a", 1)]);
  stage.sockets[0].say({ case: "error", value: { code: 14, message: "the store is away", seq: 1n } });
  await assert.rejects(recorded, { code: "UNAVAILABLE" });
  assert.equal(stage.stream.state, "open", "the stream itself goes on");
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

test("patience ends with what was tried, and the commits with it", async () => {
  const stage = staged({}, 0.3);
  stage.sockets[0].open();
  const recorded = stage.stream.commit([at("a", 1)]);
  stage.failure = new PliantError("UNREACHABLE", "nobody there");
  stage.sockets[0].drop();
  await assert.rejects(recorded, /nobody there \(tried again for 0\.3 s\)/);
  assert.equal(stage.states.at(-1), "closed: UNREACHABLE");
});

test("a server that says when to ask again is not asked before", async () => {
  const stage = staged({}, 5);
  stage.sockets[0].open();
  const asked = [];
  stage.failure = new PliantError("UNAVAILABLE", "later", 503, 1);
  stage.probed = () => asked.push(performance.now());
  stage.sockets[0].drop();
  while (asked.length < 3) await new Promise((resolve) => setTimeout(resolve, 10));
  for (const k of [1, 2]) assert.ok(asked[k] - asked[k - 1] > 990, `${asked}`);
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
