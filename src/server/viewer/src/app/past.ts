/** Undo, redo and history. The server keeps shapes; the page keeps which handles and poses led to them. */

import { batch } from "@preact/signals";
import type { HandleState } from "../model/handles.ts";
import { dropFrames } from "./dragging.ts";
import { adoptHandles } from "./handling.ts";
import { bringBack } from "./intermission.ts";
import { holdRest, keepDocument, reload } from "./opening.ts";
import { repaint } from "./painting.ts";
import * as s from "./signals.ts";
import { view } from "./view.ts";

const snapshots = new Map<string, readonly HandleState[]>();

/** Notes which handles and poses a revision has. */
export function remember(revision: bigint, handles: readonly HandleState[]): void {
  snapshots.set(String(revision), handles);
  void keepDocument();
}

/** Begins another past. */
export function forgetPast(known?: ReadonlyMap<string, readonly HandleState[]>): void {
  snapshots.clear();
  for (const [revision, handles] of known ?? []) snapshots.set(revision, handles);
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
    batch(() => {
      s.commits.value = commits;
      s.currentRevision.value = current;
    });
  } catch (error) {
    if (s.link.peek().state === "open") s.fail("The history cannot be had", error);
  }
}

export const undo = (): Promise<void> => step(-1);
export const redo = (): Promise<void> => step(1);

/** Goes to the commit with this revision. */
export async function goTo(revision: bigint): Promise<void> {
  const list = s.commits.peek();
  const from = list.findIndex((commit) => commit.revision === s.currentRevision.peek());
  const to = list.findIndex((commit) => commit.revision === revision);
  if (from >= 0 && to >= 0 && from !== to) await step(to - from);
}

let stepping = false;

/** Undoes (below 0) or redoes (above 0) so many commits, then shows where that led. */
async function step(count: number): Promise<void> {
  const open = s.doc.peek();
  if (open === undefined || stepping || s.dragging.peek()) return;
  if (count < 0 ? !s.canUndo.peek() : !s.canRedo.peek()) return;
  bringBack();
  stepping = true;
  try {
    for (let k = 0; k < Math.abs(count); k++) {
      if (count < 0) await open.session.undo();
      else await open.session.redo();
    }
    await arrive();
  } catch (error) {
    s.fail(count < 0 ? "Undo failed" : "Redo failed", error);
    await refreshHistory();
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
  }
  s.facts.value = session.facts;
  adoptHandles(session.facts, snapshots.get(String(s.currentRevision.peek())));
  repaint();
  void keepDocument();
}
