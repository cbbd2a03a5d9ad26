/**
 * Drags and commits sessions through a proxy until stdin ends, with the TypeScript client as it is.
 *
 *     node drive.mjs URL MODEL SESSIONS
 *
 * Says `ready` when all sessions are open, and at the end one line of JSON: what was acknowledged of each session, and how long its
 * stream was away. Nothing is caught here but what says that nothing was recorded: whatever the client does not get over by
 * itself ends this program.
 */

import { readFile } from "node:fs/promises";
import { setTimeout as pause } from "node:timers/promises";
import { Client } from "../../../proto/clients/typescript/dist/index.js";

const COMMIT_EVERY = 4;
const PAUSE_MS = 120;

const end = (normal, offset) => ({ region: { case: "halfSpace", value: { normal, offset } } });
const ENDS = [
  { id: "base", region: end([0, 0, -1], -0.25) },
  { id: "top", region: end([0, 0, 1], 3.75) },
];
const turned = (angle) => [{ id: "top", pose: { rotationVector: [0, 0, angle], translation: [0, 0, 0.25] } }];

let isOver = false;

async function drive(session) {
  const told = { id: session.id, commits: [], answers: 0, away: 0, reconnects: 0 };
  const positions = await session.positions();
  let shown = () => undefined;
  let failed = () => undefined;
  let newest = 0;
  const stream = session.stream({}, {
    onFrame: ({ seq, final }) => {
      stream.take(positions);
      if (final && seq >= newest) shown();
    },
    onState: (state, reason) => {
      if (state === "gone" || state === "closed") failed(reason ?? new Error(`the stream is ${state}`));
    },
    onPoseError: (error, seq) => {
      if (seq === newest) failed(error);
    },
  });
  while (!isOver) {
    const frame = new Promise((resolve, reject) => ([shown, failed] = [resolve, reject]));
    const asked = performance.now();
    newest = stream.pose(turned(0.01 * (told.answers % 50)));
    await frame;
    told.away = Math.max(told.away, (performance.now() - asked) / 1000);
    told.answers += 1;
    if (told.answers % COMMIT_EVERY === 0) {
      const angle = 0.02 * ((told.commits.length * 7) % 40) - 0.4;
      failed = () => undefined;
      newest = Infinity;
      try {
        const { revision } = await stream.commit(turned(angle));
        told.commits.push([angle, revision]);
      } catch (error) {
        // The store was away, and the commit was refused.
        if (error.code !== "UNAVAILABLE") throw error;
        told.commits.push([angle, 0]);
      }
    }
    await pause(PAUSE_MS);
  }
  told.reconnects = stream.totals.reconnects;
  stream.close();
  return told;
}

const [url, model, count] = process.argv.slice(2);
const client = new Client({ url });
const file = new Blob([await readFile(model)]);
const sessions = [];
for (let k = 0; k < Number(count); k++) {
  const session = await client.open(file, { create: { format: "obj" } });
  await session.setHandles({ handles: ENDS });
  sessions.push(session);
}
const driven = Promise.all(sessions.map(drive));
console.log("ready");
await new Promise((resolve) => process.stdin.on("end", resolve).resume());
isOver = true;
console.log(JSON.stringify(await driven));
process.exit(0);
