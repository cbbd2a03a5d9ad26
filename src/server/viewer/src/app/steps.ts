/**
 * What the hand does between commits: selecting, and choosing a handle. The server keeps commits; these steps lie between them in the
 * order in which they were done, so that undo takes back what was done last, whichever of the two it was.
 */

import { effect, signal, untracked } from "@preact/signals";
import * as s from "./signals.ts";

/** What is chosen on the page. Arrays of a selection are never written to after they are shown. */
interface Chosen {
  readonly selection: Uint8Array;
  readonly active: string | undefined;
}

interface Step {
  readonly what: string;
  readonly before: Chosen;
  readonly after: Chosen;
}

/** What was done while a commit was the current one. */
interface Stay {
  entered: Chosen;
  readonly steps: Step[];
  /** Those that are not undone. */
  done: number;
}

/** Steps that are kept, and bytes of their selections; the oldest go. */
const MOST_STEPS = 200;
const MOST_BYTES = 64 << 20;

const stays = new Map<bigint, Stay>();
let session: string | undefined;
/** As it was after the last step or commit. */
let recent: Chosen = { selection: new Uint8Array(), active: undefined };
/** Commits that were sent and not answered, what was done meanwhile, and who waits for them. */
let awaited = 0;
let late: Step[] = [];
let waiting: (() => void)[] = [];

/** What undo and redo would take back and bring again between this commit and its neighbours; nothing where a commit is next. */
export const nextSteps = signal<{ readonly back?: string; readonly forth?: string }>({});

/** Notes that the hand chose something; nothing where nothing is chosen otherwise than before. */
export function did(what: string): void {
  const step = { what, before: recent, after: now() };
  if (isSame(step.before, step.after)) return;
  recent = step.after;
  // What is done while a commit is on its way comes after it.
  if (awaited > 0) late.push(step);
  else add([step]);
  tell();
}

/** A commit chose something itself, such as the handle that it made. */
export function didCommit(): void {
  recent = now();
}

/** What is chosen now is what was chosen when the current commit came, such as after a model was opened or its triangles changed. */
export function beginHere(): void {
  const stay = here();
  if (stay.steps.length === 0) stay.entered = recent = now();
  tell();
}

/** Runs something that ends in a commit, or fails to. */
export async function committing<T>(work: () => Promise<T>): Promise<T> {
  awaited += 1;
  try {
    return await work();
  } finally {
    awaited -= 1;
    if (awaited === 0) {
      add(late.splice(0));
      tell();
      for (const go of waiting.splice(0)) go();
    }
  }
}

/** Commits that were sent and not answered. */
export function awaitedNow(): number {
  return awaited;
}

/** Waits until all commits that were sent are answered. */
export async function allAnswered(): Promise<void> {
  if (awaited > 0) await new Promise<void>((resolve) => waiting.push(resolve));
}

/** Takes the last step back; says what it was, or nothing when a commit was done after all steps. */
export function stepBack(): string | undefined {
  const stay = here();
  if (stay.done === 0) return undefined;
  stay.done -= 1;
  const { what, before } = stay.steps[stay.done] as Step;
  choose(before);
  return what;
}

/** Does the next step again that was taken back; says what it was. */
export function stepForth(): string | undefined {
  const stay = here();
  const next = stay.steps[stay.done];
  if (next === undefined) return undefined;
  stay.done += 1;
  choose(next.after);
  return next.what;
}

/** Undo (below 0) or redo led to the current commit: what was chosen there is chosen again. */
export function arrivedBy(count: number): void {
  const stay = here();
  stay.done = count < 0 ? stay.steps.length : 0;
  choose(stay.done === 0 ? stay.entered : (stay.steps.at(-1) as Step).after);
}

/** Follows the session and its commits. */
export function installSteps(): void {
  effect(() => {
    const [id] = [s.doc.value?.session.id, s.currentRevision.value, s.commits.value];
    untracked(() => enter(id));
  });
}

function enter(id: string | undefined): void {
  if (id !== session) {
    session = id;
    stays.clear();
    late = [];
    recent = now();
  }
  const known = new Set(s.commits.peek().map(({ revision }) => revision));
  for (const revision of stays.keys()) if (!known.has(revision)) stays.delete(revision);
  here();
  tell();
}

function here(): Stay {
  const revision = s.currentRevision.peek();
  let stay = stays.get(revision);
  if (stay === undefined) {
    if (late.length === 0) recent = now();
    stay = { entered: late[0]?.before ?? recent, steps: [], done: 0 };
    stays.set(revision, stay);
  }
  return stay;
}

/** Adds steps to those of the current commit, in place of what was undone. */
function add(steps: readonly Step[]): void {
  const stay = here();
  if (steps.length === 0) return;
  stay.steps.splice(stay.done, Infinity, ...steps);
  stay.done = stay.steps.length;
  const most = Math.max(8, Math.min(MOST_STEPS, Math.floor(MOST_BYTES / Math.max(1, recent.selection.length))));
  let kept = [...stays.values()].reduce((sum, { steps: its }) => sum + its.length, 0);
  for (const old of stays.values()) {
    const dropped = old.steps.splice(0, Math.max(0, kept - most)).length;
    old.done = Math.max(0, old.done - dropped);
    kept -= dropped;
  }
}

function choose({ selection, active }: Chosen): void {
  // Of other triangles it says nothing.
  const fits = selection.length === s.selection.peek().length;
  s.selection.value = fits ? selection : new Uint8Array(s.selection.peek().length);
  if (active === undefined || s.handles.peek().some(({ id }) => id === active)) s.activeId.value = active;
  recent = now();
  tell();
}

function now(): Chosen {
  return { selection: s.selection.peek(), active: s.activeId.peek() };
}

function isSame(a: Chosen, b: Chosen): boolean {
  if (a.active !== b.active || a.selection.length !== b.selection.length) return false;
  return a.selection === b.selection || a.selection.every((x, k) => x === b.selection[k]);
}

function tell(): void {
  const { steps, done } = here();
  const [back, forth] = [late.at(-1) ?? steps[done - 1], late.length > 0 ? undefined : steps[done]];
  nextSteps.value = { ...(back && { back: back.what }), ...(forth && { forth: forth.what }) };
}
