/** Animations against a server: frames in order, parts of them, cut off, left early, as a model. */

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { Client, PliantError, schema } from "../dist/index.js";
import { skip, start } from "./server.mjs";

let client;
let server;

before(async () => {
  if (skip) return;
  server = await start();
  client = new Client({ url: server.url });
});

after(() => server?.stop());

const RIG = {
  version: 1,
  joints: { tail: { at: [-0.6, 1.0, 0] }, neck: [0.45, 1.05, 0], nose: [0.9, 1.25, 0] },
  bones: [
    { id: "trunk", from: "tail", to: "neck", joint: "trunk", rest: "ORIENTATION", radius: 0.3 },
    { id: "head", from: "neck", to: "nose", parent: "trunk", joint: "head", rest: "ORIENTATION", radius: 0.25 },
  ],
};

/** A nod of so many frames. */
function nod(frames) {
  const rows = Array.from({ length: frames }, (_, k) => `0 ${k} 0 0 0 0 ${20 * Math.sin(0.3 * k)} 0 10`);
  return `HIERARCHY
ROOT trunk
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT head
  {
    OFFSET 100 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 30 0 0
    }
  }
}
MOTION
Frames: ${frames}
Frame Time: 0.1
${rows.join("\n")}
`;
}

async function all(animation) {
  const frames = [];
  for await (const frame of animation) frames.push(frame);
  return frames;
}

const digests = (frames) => frames.map(({ digest }) => digest);

test("frames come in order, and a part of them is the same", { skip }, async () => {
  const session = await client.sample();
  const rest = await session.positions();
  const playing = session.animate({ bvh: nod(8), rig: RIG, skipFirst: 2 });
  const positions = new Float32Array(rest.length);
  let farthest = 0;
  const frames = [];
  for await (const frame of playing) {
    frame.frame.positionsInto(positions);
    farthest = positions.reduce((most, x, k) => Math.max(most, Math.abs(x - rest[k])), farthest);
    frames.push(frame);
  }
  assert.deepEqual(frames.map(({ index, count }) => [index, count]), Array.from({ length: 8 }, (_, k) => [k, 8]));
  assert.ok(farthest > 0.02, `${farthest}`);
  assert.ok(frames[7].rootTranslation[1] > 0 && frames[7].frame.quality.flippedTriangles < 50);
  assert.equal(playing.report.totals.frames, 8);
  const part = await all(session.animate({ bvh: new Blob([nod(8)]), rig: RIG, skipFirst: 2, first: 5, count: 2 }));
  assert.deepEqual(digests(part), digests(frames).slice(5, 7));
  assert.deepEqual(await session.positions(), rest, "the session is as it was");
  await session.close();
});

test("a model's own clip is played, and comes as a model", { skip }, async () => {
  const figure = await (await fetch(`${server.url}/v1/sample.glb?name=figure`)).blob();
  const session = await client.open(figure, { create: { format: "glb" } });
  const walk = await all(session.animate({ clip: "walk", count: 3 }));
  assert.deepEqual(digests(walk), digests(await all(session.animate({ clip: 0, count: 3 }))));
  const glb = await session.animatedModel({ clip: "walk", count: 3 });
  assert.equal(await glb.slice(0, 4).text(), "glTF");
  await session.close();
});

test("what is wrong is said", { skip }, async () => {
  const session = await client.sample();
  const refused = (options, told) =>
    assert.rejects(all(session.animate(options)), (error) => error instanceof PliantError && error.message.includes(told));
  await refused({ bvh: "no clip", rig: RIG }, "line 1: a BVH file begins with HIERARCHY");
  await refused({ bvh: nod(3) }, "rig");
  await refused({ clip: "dance" }, '"dance" is not a clip');
  await session.close();
});

test("a lost connection loses no frame", { skip }, async () => {
  let cuts = 2;
  let most = 150_000;
  const cutting = async (url, init) => {
    const response = await fetch(url, init);
    if (!String(url).endsWith("/animations") || cuts === 0) return response;
    cuts -= 1;
    const reader = response.body.getReader();
    let left = most;
    const body = new ReadableStream({
      async pull(to) {
        const { done, value } = await reader.read();
        if (done) return to.close();
        to.enqueue(value.subarray(0, left));
        left -= value.length;
        if (left <= 0) {
          await reader.cancel();
          to.error(new TypeError("cut"));
        }
      },
    });
    return new Response(body, { headers: response.headers });
  };
  const session = await client.sample();
  const cut = await new Client({ url: server.url, fetch: cutting }).session(session.id);
  const playing = cut.animate({ bvh: nod(12), rig: RIG });
  const rest = await session.positions();
  const exact = await all(session.animate({ bvh: nod(12), rig: RIG }));
  assert.deepEqual(digests(await all(playing)), digests(exact));
  assert.equal(playing.reconnects, 2);
  // Frames that tell what differs begin anew on each connection.
  cuts = 1;
  most = 30_000;
  const told = cut.animate({ bvh: nod(12), rig: RIG, output: { encoding: schema.Frame_Encoding.DELTA } });
  const frames = await all(told);
  assert.deepEqual([digests(frames), told.reconnects], [digests(exact), 1]);
  frames.forEach(({ frame }, k) => {
    const [a, b] = [frame, exact[k].frame].map((one) => {
      const positions = rest.slice();
      one.positionsInto(positions);
      return positions;
    });
    const worst = a.reduce((far, x, at) => Math.max(far, Math.abs(x - b[at])), 0);
    assert.ok(worst > 0 && worst < 1e-4, `off by ${worst}`);
  });
  await session.close();
});

test("leaving the loop stops it", { skip }, async () => {
  const session = await client.sample();
  for await (const { count } of session.animate({ bvh: nod(60), rig: RIG, fps: 10000 })) {
    assert.ok(count > 10000);
    break;
  }
  const running = async () => /pliant_animations (\d+)/.exec(await (await fetch(`${server.url}/metrics`)).text())[1];
  while ((await running()) !== "0") await new Promise((resolve) => setTimeout(resolve, 10));
  await session.close();
});
