/** Undo, redo and history. The server keeps shapes; the page keeps which handles and poses led to them. */

import { batch, computed, signal } from "@preact/signals";
import type { schema } from "pliant-client";
import type { HandleState } from "../model/handles.ts";
import { dropFrames } from "./dragging.ts";
import { isStale, showsRevision } from "./following.ts";
import { adoptHandles } from "./handling.ts";
import { bringBack } from "./intermission.ts";
import { holdRest, keepDocument, reload } from "./opening.ts";
import { repaint } from "./painting.ts";
import * as s from "./signals.ts";
import { allAnswered, arrivedBy, nextSteps, stepBack, stepForth } from "./steps.ts";
import { view } from "./view.ts";

const snapshots = new Map<string, readonly HandleState[]>();
/** What made each revision, in words; those of others have the server's kind. */
const deeds = signal<ReadonlyMap<string, string>>(new Map());

const KINDS: Record<string, string> = { create: "Opened", handles: "Handles", pose: "Pose", edit: "Edit" };

/** What a commit did, for people. */
export function nameOf({ revision, kind }: Pick<schema.Commit, "revision" | "kind">): string {
  return deeds.value.get(String(revision)) ?? KINDS[kind] ?? kind;
}

/** Notes which handles and poses a revision has, and what made it. */
export function remember(revision: bigint, handles: readonly HandleState[], what?: string): void {
  snapshots.set(String(revision), handles);
  if (what !== undefined) deeds.value = new Map(deeds.peek()).set(String(revision), what);
  void keepDocument();
}

/** Begins another past. */
export function forgetPast(
  known?: ReadonlyMap<string, readonly HandleState[]>,
  names?: ReadonlyMap<string, string>,
): void {
  snapshots.clear();
  for (const [revision, handles] of known ?? []) snapshots.set(revision, handles);
  deeds.value = new Map(names ?? []);
}

/** Takes up what another window knows of the same past; what this one knows stays. */
export function learnPast(
  known: ReadonlyMap<string, readonly HandleState[]> | undefined,
  names: ReadonlyMap<string, string> | undefined,
): void {
  for (const [revision, handles] of known ?? []) if (!snapshots.has(revision)) snapshots.set(revision, handles);
  deeds.value = new Map([...(names ?? []), ...deeds.peek()]);
}

export function pastNames(): ReadonlyMap<string, string> {
  return deeds.peek();
}

export function pastSnapshots(): ReadonlyMap<string, readonly HandleState[]> {
  return snapshots;
}

/** Asks the server for the list of commits. */
export async function refreshHistory(): Promise<void> {
  const open = s.doc.peek();
  if (open === undefined) return;
  try {
    const { commits, current } = await open.session.history();
    if (s.doc.peek()?.session !== open.session) return;
    const known = new Set(commits.map(({ revision }) => String(revision)));
    for (const revision of snapshots.keys()) if (!known.has(revision)) snapshots.delete(revision);
    deeds.value = new Map([...deeds.peek()].filter(([revision]) => known.has(revision)));
    batch(() => {
      s.commits.value = commits;
      s.currentRevision.value = current;
    });
  } catch (error) {
    if (s.link.peek().state === "open") s.fail("The history cannot be loaded", error);
  }
}

/** What undo would take back, and redo do again; nothing where there is nothing. */
export const undoes = computed(() => nextSteps.value.back ?? commitTo(-1));
export const redoes = computed(() => nextSteps.value.forth ?? commitTo(1));

/** The commit that undo (-1) leaves or redo (1) leads to, in words. */
function commitTo(way: -1 | 1): string | undefined {
  const list = s.commits.value;
  const at = list.findIndex(({ revision }) => revision === s.currentRevision.value);
  const commit = way < 0 ? list[at > 0 ? at : list.length] : list[at + 1];
  return commit && nameOf(commit);
}

export const undo = (): Promise<void> => travel(-1);
export const redo = (): Promise<void> => travel(1);

let travelling = false;

/** Takes back what the hand did last, or does again what it took back last, and says what that was. */
async function travel(way: -1 | 1): Promise<void> {
  if (s.doc.peek() === undefined || travelling || s.dragging.peek() || s.drawing.peek()) return;
  travelling = true;
  try {
    await allAnswered();
    bringBack();
    if (await isStale(way < 0 ? "Undo" : "Redo")) return;
    const local = way < 0 ? stepBack() : stepForth();
    const what = local ?? commitTo(way);
    if (what === undefined || (local === undefined && !(await step(way)))) return;
    s.noteTravel(way < 0 ? "Undone" : "Redone", what);
  } finally {
    travelling = false;
  }
}

/** Goes to the commit with this revision. */
export async function goTo(revision: bigint): Promise<void> {
  if (await isStale("Going to another commit")) return;
  const list = s.commits.peek();
  const from = list.findIndex((commit) => commit.revision === s.currentRevision.peek());
  const to = list.findIndex((commit) => commit.revision === revision);
  if (from >= 0 && to >= 0 && from !== to) await step(to - from);
}

let stepping = false;

/** Undoes (below 0) or redoes (above 0) so many commits, then shows where that led; whether it did. */
async function step(count: number): Promise<boolean> {
  const open = s.doc.peek();
  if (open === undefined || stepping || s.dragging.peek()) return false;
  if (count < 0 ? !s.canUndo.peek() : !s.canRedo.peek()) return false;
  bringBack();
  stepping = true;
  try {
    for (let k = 0; k < Math.abs(count); k++) {
      if (count < 0) await open.session.undo();
      else await open.session.redo();
    }
    await arrive();
    arrivedBy(count);
    return true;
  } catch (error) {
    s.fail(count < 0 ? "Undo failed" : "Redo failed", error);
    await refreshHistory();
    return false;
  } finally {
    stepping = false;
  }
}

/** Shows the session's current commit: its topology, shape and handles. */
export async function arrive(): Promise<void> {
  const open = s.doc.peek();
  if (open === undefined) return;
  const { session, name } = open;
  const before = s.topologyRevision.peek();
  const former = s.handles.peek();
  let stayed: readonly HandleState[] = [];
  holdRest();
  await refreshHistory();
  if (s.topologyRevision.peek() !== before) {
    await reload(session, name);
  } else {
    const positions = await session.positions();
    const { surface } = view().stage;
    dropFrames();
    surface?.positions.set(positions);
    surface?.moved(false);
    // What others made is not written down here; what looks the same is taken for the same.
    const told = new Map(session.facts.handles.map(({ id, vertices }) => [id, vertices]));
    stayed = former.filter(({ id, count }) => told.get(id) === count);
  }
  s.facts.value = session.facts;
  showsRevision(session.facts.revision);
  adoptHandles(session.facts, snapshots.get(String(s.currentRevision.peek())) ?? stayed);
  repaint();
  void keepDocument();
}
