/** What becomes of a session with work in it when another model takes its place, or its own is closed: the user says. */

import { signal } from "@preact/signals";
import * as s from "./signals.ts";
import { pastNames } from "./past.ts";

/** What the user wants: keep the session on the server, discard it, or stay. */
export type Leaving = "keep" | "discard" | "stay";

export interface LeavingQuestion {
  readonly name: string;
  readonly answer: (what: Leaving) => void;
}

export const leavingQuestion = signal<LeavingQuestion | undefined>(undefined);

/** The commit of handles that opening makes. */
export const OPENING_DEED = "Handles set";

/** Asks what becomes of the session that is open; one in which nothing was done needs no question. */
export function askLeaving(): Promise<Leaving> {
  const open = s.doc.peek();
  if (open === undefined || s.link.peek().state === "gone" || !hasWork()) return Promise.resolve("discard");
  leavingQuestion.peek()?.answer("stay");
  return new Promise((resolve) => {
    const answer = (what: Leaving): void => {
      leavingQuestion.value = undefined;
      resolve(what);
    };
    leavingQuestion.value = { name: open.name, answer };
  });
}

/** Whether somebody made handles, poses or edits. */
function hasWork(): boolean {
  const names = pastNames();
  return s.commits.peek().some(({ kind, revision }) => kind !== "create" && names.get(String(revision)) !== OPENING_DEED);
}
