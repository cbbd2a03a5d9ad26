/** Making, changing and removing handles. */

import { batch } from "@preact/signals";
import type { Vector, schema } from "pliant-client";
import { type GuideKind, guideAround } from "../model/guides.ts";
import { AT_REST, type HandleState, type Hold, PALETTE, heldPose, isAtRest, messageOf, movesFreely, poseOf } from "../model/handles.ts";
import type { TransformKind } from "../model/transform.ts";
import { commitPoses } from "./dragging.ts";
import { changedHere, isStale, takeOver } from "./following.ts";
import { bringBack } from "./intermission.ts";
import { OPENING_DEED } from "./leaving.ts";
import { refreshHistory, remember } from "./past.ts";
import * as s from "./signals.ts";
import { origin, toPage } from "./space.ts";
import { committing, didCommit } from "./steps.ts";

type Facts = schema.Session;
type HandleFacts = schema.HandleFacts;

/** How strongly a guide leads: as good as exactly. */
const LED_STIFFNESS = 1000;
const GUIDE_NAMES: Readonly<Record<GuideKind, string>> = { curve: "Curve", lattice: "Lattice" };

/** Fields of a handle whose absence means something. */
const CLEARABLE = ["constrains", "stiffness", "rigid", "pose", "falloff"] as const;

/** Makes a handle of the selection, which a guide around it leads where one is asked for. */
export async function makeHandle(hold: Hold, led?: GuideKind): Promise<void> {
  const open = s.doc.peek();
  const vertices = selectedVertices();
  const selectedWith = s.tool.peek();
  if (open === undefined) return;
  if (vertices.length === 0) {
    s.note("info", "Nothing is selected", "Paint, box, lasso or click a part first.");
    return;
  }
  const taken = new Set(s.handles.peek().map(({ id }) => id));
  let number = s.handles.peek().length + 1;
  while (taken.has(`handle-${number}`)) number += 1;
  const hues = s.handles.peek().filter(({ hold: its }) => its !== "pin").map(({ hue }) => hue);
  const hue = PALETTE.findIndex((_, k) => !hues.includes(k));
  const handle: HandleState = {
    id: `handle-${number}`,
    name: `${led !== undefined ? GUIDE_NAMES[led] : hold === "pin" ? "Pin" : hold === "soft" ? "Soft" : "Grip"} ${number}`,
    hue: hue < 0 ? number % PALETTE.length : hue,
    hold,
    vertices,
    count: vertices.length,
    pivot: [0, 0, 0],
    stiffness: led === undefined ? 1 : LED_STIFFNESS,
    falloff: { radius: open.report.diagonal * 0.05, kind: "NONE" },
    constrains: { position: true, rotation: true, scale: true },
    rigid: false,
    pose: AT_REST,
    guide: led === undefined ? undefined : guideAround(led, vertices, open.rest),
  };
  await changing(`${handle.name} made`, "The handle was not made", async () => {
    const told = await open.session.putHandle(messageOf(handle, origin()));
    batch(() => {
      merge(told, [...s.handles.peek(), handle]);
      s.selection.value = new Uint8Array(s.selection.peek().length);
      s.activeId.value = handle.id;
      // What is gripped is dragged next, unless the user has chosen another tool meanwhile.
      if (hold !== "pin" && s.tool.peek() === selectedWith) s.tool.value = "move";
    });
  });
}

/** Changes a handle; when something is bent, the shape follows. */
export async function changeHandle(id: string, change: Partial<HandleState>): Promise<void> {
  const open = s.doc.peek();
  const before = s.handles.peek().find((handle) => handle.id === id);
  if (open === undefined || before === undefined) return;
  const handle = { ...before, ...change };
  if (Object.keys(change).every((key) => key === "name" || key === "hue")) {
    s.handles.value = s.handles.peek().map((h) => (h.id === id ? handle : h));
    remember(s.currentRevision.peek(), s.handles.peek());
    return;
  }
  const done = await changing(`${handle.name} changed`, "The handle was not changed", async () => {
    // The region stays as it is; of the rest, what the message leaves out is at its default.
    const { region: _, ...message } = messageOf(handle, origin());
    const clear = CLEARABLE.filter((field) => message[field] === undefined || message[field] === false);
    const told = await open.session.putHandle(message, { clear });
    merge(told, s.handles.peek().map((h) => (h.id === id ? handle : h)));
  });
  if (done && s.handles.peek().some((h) => !isAtRest(h.pose))) await commitPoses(s.handles.peek().map((h) => h.id));
}

export async function removeHandle(id: string): Promise<void> {
  const open = s.doc.peek();
  if (open === undefined) return;
  const name = s.handles.peek().find((handle) => handle.id === id)?.name ?? id;
  await changing(`${name} removed`, "The handle was not removed", async () => {
    const told = await open.session.removeHandle(id);
    batch(() => {
      if (s.activeId.peek() === id) s.activeId.value = undefined;
      merge(told, s.handles.peek().filter((handle) => handle.id !== id));
    });
  });
}

/** Puts handles and their poses on a model that has none, and solves. */
export async function setAllHandles(wanted: readonly HandleState[]): Promise<void> {
  const open = s.doc.peek();
  if (open === undefined) return;
  const known = wanted.filter((handle) => handle.vertices !== undefined);
  const done = await changing(OPENING_DEED, "The handles were not set", async () => {
    merge(await open.session.setHandles({ handles: known.map((handle) => messageOf(handle, origin())) }), known);
  });
  s.activeId.value = known.findLast(({ hold }) => hold !== "pin")?.id;
  if (done && known.some(({ pose }) => !isAtRest(pose))) await commitPoses(known.map(({ id }) => id));
}

/** Has the parts that look hard keep their shape, or lets them bend again; the shape follows. */
export async function keepHardParts(stiff: boolean): Promise<void> {
  const open = s.doc.peek();
  const known = s.handles.peek();
  if (open === undefined) return;
  if (known.some(({ vertices }) => vertices === undefined)) {
    s.note("info", "Not changed", "A handle was set elsewhere, and the page does not know its region.");
    return;
  }
  const done = await changing(stiff ? "Hard parts stiff" : "All parts soft", "Nothing was changed", async () => {
    merge(await open.session.setHandles({ handles: known.map((handle) => messageOf(handle, origin())), ...(stiff ? { stiff: { auto: true } } : {}) }), known);
  });
  if (!done) return;
  if (stiff && s.facts.peek()?.solver?.stiffParts === 0) s.note("info", "No hard parts", "Nothing of the model looks like one, or handles hold them.");
  if (known.some(({ pose }) => !isAtRest(pose))) await commitPoses(known.map(({ id }) => id));
}

/** The pose of a handle as it lies, which turns automatically no more. */
export function asItLies({ id, pose, pivot }: HandleState): HandleState["pose"] {
  const turn = pose.freely ? s.foundTurns.peek().get(id) : undefined;
  if (turn === undefined) return { ...pose, freely: false };
  const [x, y, z] = s.facts.peek()?.handles.find((handle) => handle.id === id)?.centroid ?? [];
  const middle = x === undefined || y === undefined || z === undefined ? pivot : toPage([x, y, z]);
  return heldPose(pose, turn, pivot, middle);
}

/** The pose that a transform of a handle begins from: what has turned automatically is turned on from how it lies. */
export function startOf(handle: HandleState, kind: TransformKind): HandleState["pose"] {
  const { pose } = handle;
  if (kind === "rotate") return asItLies(handle);
  return { ...pose, freely: movesFreely(handle, pose) && (kind === "move" || pose.freely) };
}

/** Sets the pose of a handle from numbers rather than from the gizmo. */
export async function poseHandle(id: string, pose: HandleState["pose"]): Promise<void> {
  s.handles.value = s.handles.peek().map((handle) => (handle.id === id ? { ...handle, pose } : handle));
  await commitPoses([id]);
}

/** Takes the handles and poses that the server reports; keeps what else the page knows of them. */
export function adoptHandles(facts: Facts, known: readonly HandleState[] = []): void {
  const told = (handle: HandleState): HandleState => {
    const its = facts.handles.find(({ id }) => id === handle.id);
    return its === undefined ? handle : { ...handle, pose: poseOf(its.pose, handle.pivot, origin(), handle.pose) };
  };
  merge(facts, known.map(told));
  const active = s.activeId.peek();
  if (!s.handles.peek().some(({ id }) => id === active)) {
    s.activeId.value = s.handles.peek().find(({ hold }) => hold !== "pin")?.id;
  }
}

/** The creature's feet and head, as the built-in session has them. */
export function sampleHandles(open: s.Document | undefined): HandleState[] {
  if (open === undefined) return [];
  const { positions } = open.topology;
  const where = (test: (x: number, y: number, z: number) => boolean): Uint32Array => {
    const found: number[] = [];
    for (let k = 0; k < positions.length; k += 3) {
      if (test(positions[k] as number, positions[k + 1] as number, positions[k + 2] as number)) found.push(k / 3);
    }
    return Uint32Array.from(found);
  };
  const feet = where((_, y) => y <= 0.14);
  const head = where((x, y, z) => Math.hypot(x - 0.76, y - 1.22, z) <= 0.36);
  return [
    { ...unknown("feet", 0), name: "Feet", hold: "pin", vertices: feet },
    { ...unknown("head", 0), name: "Head", vertices: head },
  ];
}

/** Selected render vertices, ascending. */
function selectedVertices(): Uint32Array {
  const marks = s.selection.peek();
  const found: number[] = [];
  for (let v = 0; v < marks.length; v++) if (marks[v] === 1) found.push(v);
  return Uint32Array.from(found);
}

/** Runs a change of handles and notes where it led, and what it was. */
async function changing(what: string, failure: string, change: () => Promise<void>): Promise<boolean> {
  bringBack();
  if (await isStale(what)) return false;
  try {
    await committing(async () => {
      await change();
      didCommit();
      const revision = s.facts.peek()?.revision ?? 0n;
      remember(revision, s.handles.peek(), what);
      const elsewhere = changedHere(revision);
      await refreshHistory();
      if (elsewhere) void takeOver();
    });
    return true;
  } catch (error) {
    s.fail(failure, error);
    return false;
  }
}

/** Merges the server's handles with what `known` says about each; the others have the server's poses. */
function merge(facts: Facts, known: readonly HandleState[]): void {
  s.facts.value = facts;
  s.foundTurns.value = new Map(facts.handles.flatMap(({ id, foundTurn: [x, y, z] }) => (x === undefined || y === undefined || z === undefined ? [] : [[id, [x, y, z]]])));
  s.handles.value = facts.handles.map((told, k) => {
    const pivot = pivotOf(told);
    const own = known.find(({ id }) => id === told.id) ?? { ...unknown(told.id, k), pivot, pose: poseOf(told.pose, pivot, origin()) };
    return { ...own, count: told.vertices, pivot: isAtRest(own.pose) ? pivot : own.pivot };
  });
}

function pivotOf({ pivot: [x, y, z] }: HandleFacts): Vector {
  return toPage([x ?? 0, y ?? 0, z ?? 0]);
}

/** A handle of which only the name is known. */
function unknown(id: string, hue: number): HandleState {
  return {
    id,
    name: id,
    hue,
    hold: "grip",
    vertices: undefined,
    count: 0,
    pivot: [0, 0, 0],
    stiffness: 1,
    falloff: { radius: 0, kind: "NONE" },
    constrains: { position: true, rotation: true, scale: true },
    rigid: false,
    pose: AT_REST,
  };
}
