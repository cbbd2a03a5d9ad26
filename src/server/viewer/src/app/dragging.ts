/** The live drag: poses to the stream, frames into the surface, and their facts into the meters. */

import { type FrameFacts, type PoseEntry, type Session, type SolveOptions, type Stream, type Vector, schema } from "pliant-client";
import { type HandlePose, type HandleState, entryOf, searchingFrom } from "../model/handles.ts";
import { changedElsewhere, changedHere, takeOver } from "./following.ts";
import { bringBack, onScreen } from "./intermission.ts";
import { repaint } from "./painting.ts";
import { keepDocument } from "./opening.ts";
import { frameEncoding } from "./packing.ts";
import { refreshHistory, remember } from "./past.ts";
import * as s from "./signals.ts";
import { origin } from "./space.ts";
import { allAnswered, committing } from "./steps.ts";
import { view } from "./view.ts";

/** The server's defaults of `refine`. */
const USUAL_REFINE = { dragging: 0, commit: 4 };

/** Milliseconds of a painted frame that stretch colours may take while dragging, on average. */
const COLOURING_MS = 5;
/** How often an open session is asked for, so that it stays. */
const RENEW_MS = 60_000;

let stream: Stream | undefined;
let alive: ReturnType<typeof setInterval> | undefined;
let pending: PoseEntry[] | undefined;
/** The rotations that the newest frame of the drag under way has for handles that turn freely. */
let dragTurns: ReadonlyMap<string, Vector> = new Map();
/** Whether the last drag was given up: its frames are of no use, the shape is that of the last commit. */
let givenUp = false;
/** Shapes painted so far, and what decoding and shading them took. */
const sums = { painted: 0, takenMs: 0 };
/** What bringing the stretch colours up to date took, and frames since. */
const colouring = { tookMs: 0, waited: 0 };
/** When shapes were painted in the last second. */
let painted: number[] = [];

/** How the stream solves, by the settings. */
function solveOptions(refine: number | undefined): SolveOptions {
  const { tolerance, maxError, progressive, window, firstPass, method } = s.settings.peek();
  return {
    ...(maxError > 0 ? { maxError } : { tolerance }),
    progressive,
    window,
    firstPass: schema.Options_FirstPass[firstPass],
    method: schema.Options_Method[method],
    output: { encoding: frameEncoding((s.doc.peek()?.rest.length ?? 0) / 3) },
    ...(refine === undefined ? {} : { refine }),
  };
}

function draggingOptions(): SolveOptions {
  const { refineDragging, refineCommit } = s.settings.peek();
  const usual = refineDragging === USUAL_REFINE.dragging && refineCommit === USUAL_REFINE.commit;
  return solveOptions(usual ? undefined : refineDragging);
}

export function startStream(session: Session): void {
  stopStream();
  const { stage } = view();
  const mine: Stream = session.stream(draggingOptions(), {
    onState: (state, reason) => {
      // A stream that was replaced has nothing more to say about the page.
      if (stream !== undefined && stream !== mine) return;
      s.link.value = { state, ...(reason === undefined ? {} : { reason }) };
      // What failed before means nothing to a session that is no more.
      if (state === "gone") s.dismissErrors();
    },
    onFrame: () => stage.request(),
    onPoseError: (error) => s.fail("The server rejected the pose", error),
    onNotice: (code, message) => code !== "going-away" && s.note("info", message),
    // What was dragged waits on the page for as long as the page is open; the user sees that, and may try at once.
  }, { patience: Number.POSITIVE_INFINITY });
  stream = mine;
  s.link.value = { state: mine.state };
  // A session that nobody calls expires, even while its model is being looked at.
  alive = setInterval(() => void session.refresh().catch(() => undefined).then(changedElsewhere), RENEW_MS);
}

export function stopStream(): void {
  const old = stream;
  stream = undefined;
  pending = undefined;
  givenUp = false;
  dragTurns = new Map();
  clearInterval(alive);
  old?.close();
}

/** Tries to reach the server at once. */
export function retryNow(): void {
  stream?.retry();
}

/** The options changed: they hold from the next pose on. */
export function applyOptions(): void {
  stream?.setOptions(draggingOptions());
}

/** A handle at a pose, as the server takes it. */
function entryAt(id: string, pose: HandlePose): PoseEntry {
  const { pivot, guide } = s.handles.peek().find((handle) => handle.id === id) ?? { pivot: [0, 0, 0] as const, guide: undefined };
  return entryOf({ id, pose, pivot, guide }, origin());
}

/** Shows a handle at a pose; the newest wins. */
export function dragTo(id: string, pose: HandlePose): void {
  setPose(id, pose);
  pending = [entryAt(id, pose)];
  givenUp = false;
  view().stage.request();
}

/**
 * Cancels a drag: the handle goes back to where it was, nothing is recorded, and the shape equals the last commit bit
 * for bit.
 */
export async function giveUpDrag(id: string, pose: HandlePose): Promise<void> {
  const current = stream;
  const open = s.doc.peek();
  setPose(id, pose);
  pending = undefined;
  if (current === undefined || open === undefined) return;
  givenUp = true;
  dragTurns = new Map();
  // The stream's next commit records what was dragged on it: this is.
  current.pose([entryAt(id, pose)]);
  try {
    await allAnswered();
    const positions = await open.session.positions();
    const { surface } = view().stage;
    if (!givenUp || stream !== current || surface === undefined || onScreen.peek() !== undefined) return;
    surface.positions.set(positions);
    surface.moved(false);
    if (s.settings.peek().colouring === "stretch") repaint();
    view().stage.request();
  } catch {
    // Where the server is away the frame that answers the pose shows it, when it is back.
    givenUp = false;
  }
}

/** Records the poses of these handles, as they are now. */
export function commitPoses(ids: readonly string[]): Promise<void> {
  return committing(() => recordPoses(ids));
}

async function recordPoses(ids: readonly string[]): Promise<void> {
  const current = stream;
  if (current === undefined) return;
  bringBack();
  pending = undefined;
  givenUp = false;
  // What the commit makes of the handles is what they are now, whatever is dragged before its answer comes.
  // Its search begins where that of the drag has ended, so that both find the same.
  const recordedHandles = searchingFrom(s.handles.peek(), dragTurns);
  s.handles.value = recordedHandles;
  dragTurns = new Map();
  const poses = recordedHandles.filter(({ id }) => ids.includes(id));
  const { refineDragging, refineCommit } = s.settings.peek();
  const differs = refineDragging !== refineCommit && draggingOptions().refine !== undefined;
  if (differs) current.setOptions(solveOptions(refineCommit));
  const recorded = current.commit(poses.map((posed) => entryOf(posed, origin())));
  if (differs) current.setOptions(draggingOptions());
  s.recording.value += 1;
  // Before the answer, which a server that ends now does not give.
  void keepDocument();
  try {
    const frame = await recorded;
    if (stream !== current) return;
    const elsewhere = changedHere(BigInt(frame.revision));
    if (frame.quality !== undefined) s.quality.value = frame.quality;
    const [moved] = poses;
    s.foundTurns.value = frame.foundTurns;
    remember(BigInt(frame.revision), recordedHandles, poses.length === 1 && moved !== undefined ? `${moved.name} posed` : "Handles posed");
    await refreshHistory();
    // The pose was added to what others did: that is shown, too.
    if (elsewhere) await takeOver();
  } catch (error) {
    // Of a session that is gone the dialog tells, and offers to open the model with this pose.
    if (stream === current && current.state !== "gone") s.fail("The pose was not recorded", error);
  } finally {
    s.recording.value -= 1;
  }
}

function setPose(id: string, pose: HandlePose): void {
  s.handles.value = s.handles.peek().map((handle) => (handle.id === id ? { ...handle, pose } : handle));
}

/** Frames that wait belong to a shape that is no longer shown. */
export function dropFrames(): void {
  stream?.drop();
}

/** Before each painted frame: the newest pose goes out, the newest shape comes in. */
export function turn(now: number): void {
  const { stage } = view();
  const { surface } = stage;
  // A clip or an animation shows shapes of its own; frames wait until it is closed.
  if (stream === undefined || surface === undefined || onScreen.peek() !== undefined) return;
  if (pending !== undefined) {
    stream.pose(pending);
    pending = undefined;
  }
  if (givenUp) stream.drop();
  const begun = performance.now();
  const frame = stream.take(surface.positions);
  if (frame === undefined) {
    if (!s.dragging.peek()) surface.settle();
    return;
  }
  if (frame.quality === undefined) dragTurns = frame.foundTurns;
  surface.moved(s.dragging.peek());
  if (s.settings.peek().colouring === "stretch") colour();
  sums.painted += 1;
  sums.takenMs += performance.now() - begun;
  measure(frame, now);
}

/** Brings stretch colours up to date; while dragging only as often as leaves time to paint. */
function colour(): void {
  colouring.waited += 1;
  if (s.dragging.peek() && colouring.waited * COLOURING_MS < colouring.tookMs) return;
  const begun = performance.now();
  repaint();
  colouring.tookMs = performance.now() - begun;
  colouring.waited = 0;
}

/** For measurements: shapes painted since the page was loaded. */
export function paintedSoFar(): Readonly<typeof sums> {
  return { ...sums };
}

function measure(frame: FrameFacts, now: number): void {
  painted = [...painted.filter((at) => now - at < 1000), now];
  const first = painted[0] as number;
  const fps = painted.length > 1 ? ((painted.length - 1) * 1000) / Math.max(1, now - first) : 0;
  const { solveMs, queueMs, maxError, residual, bytes, final } = frame;
  s.meters.value = { solveMs, queueMs, maxError, residual, bytes, fps, final };
  s.superseded.value = stream?.totals.superseded ?? 0;
}
