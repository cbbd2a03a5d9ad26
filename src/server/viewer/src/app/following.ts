/**
 * A session may be open in other windows, and called by programs. What they change is taken over before the hand changes something
 * itself, and when the window gets the focus, so that nothing is done to a state that the user has not seen.
 */

import { kept } from "./keeping.ts";
import { arrive, learnPast } from "./past.ts";
import * as s from "./signals.ts";
import { allAnswered, awaitedNow, beginHere } from "./steps.ts";

/** The session's revision without changes from elsewhere. Every change adds one, also those from elsewhere. */
let expected = { revision: 0n };
let looking: Promise<boolean> | undefined;

/** The page shows the session as it is at this revision. */
export function showsRevision(revision: bigint): void {
  expected = { revision };
}

/** A change of this page was answered with this revision. Answers whether others have changed something before it. */
export function changedHere(revision: bigint): boolean {
  expected = { revision: expected.revision + 1n };
  // Answers of changes that are on their way together may come in another order; what is amiss is found later.
  return revision > expected.revision && awaitedNow() === 1;
}

/** Asks the server whether the session was changed elsewhere; where it was, shows what it is now. Answers whether it was. */
export function changedElsewhere(): Promise<boolean> {
  looking ??= look().finally(() => (looking = undefined));
  return looking;
}

/** As `changedElsewhere`, for what was asked for and is not done then: it says so. */
export async function isStale(what: string): Promise<boolean> {
  if (!(await changedElsewhere())) return false;
  s.note("info", `Not done: ${what}`, "This page shows the changed model now. Repeat it if you still want it.");
  return true;
}

async function look(): Promise<boolean> {
  await allAnswered();
  const open = s.doc.peek();
  if (open === undefined || s.link.peek().state === "gone" || s.busy.peek() !== undefined) return false;
  const before = expected;
  try {
    const { revision } = await open.session.refresh();
    // What this page did meanwhile is no news, and a hand that drags is not disturbed: its commit will tell.
    if (expected !== before || awaitedNow() > 0 || s.dragging.peek() || s.doc.peek()?.session !== open.session) return false;
    if (revision <= expected.revision) return false;
  } catch {
    // Of a server that is away the stream tells.
    return false;
  }
  await takeOver();
  return true;
}

/** Shows the session as others have left it. */
export async function takeOver(): Promise<void> {
  const open = s.doc.peek();
  if (open === undefined) return;
  try {
    // Another window of this browser has written down what it calls its handles.
    const record = await kept(open.session.id);
    learnPast(record?.past, record?.names);
    await arrive();
    beginHere();
    s.note("info", "Changed in another window", "The page shows the model as it is now.");
  } catch (error) {
    s.fail("The model was changed in another window, and the page cannot show the new state", error);
  }
}

/** Looks whenever the window gets the focus or is seen again. */
export function installFollowing(): void {
  const attend = (): void => {
    if (document.visibilityState === "visible") void changedElsewhere();
  };
  addEventListener("focus", attend);
  document.addEventListener("visibilitychange", attend);
}
