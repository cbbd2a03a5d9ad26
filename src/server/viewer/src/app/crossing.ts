/** Where the surface passes through itself: asked of the server for the recorded shape while the page is to show it. */

import { effect, signal } from "@preact/signals";
import type { schema } from "pliant-client";
import { onScreen } from "./intermission.ts";
import * as s from "./signals.ts";
import { view } from "./view.ts";

/** What was found in the shape that is shown; nothing while it is not known. */
export const crossings = signal<schema.CrossingsResponse | undefined>(undefined);

let asked = 0;

/** Keeps the marks up to date: they are those of the last commit, and gone while something else is shown or dragged. */
export function installCrossing(): void {
  effect(() => {
    const open = s.doc.value;
    void s.currentRevision.value;
    const wanted = s.settings.value.colouring === "crossings" && onScreen.value === undefined && !s.dragging.value && s.recording.value === 0;
    const mine = ++asked;
    crossings.value = undefined;
    if (open !== undefined && wanted) void ask(open.session, mine);
  });
  effect(() => {
    const found = crossings.value;
    if (s.doc.value === undefined) return;
    view().stage.surface?.mark(found?.triangles ?? [], found?.atRest ?? []);
    view().stage.request();
  });
}

async function ask(session: s.Document["session"], mine: number): Promise<void> {
  try {
    const found = await session.crossings();
    if (mine === asked) crossings.value = found;
  } catch (error) {
    if (mine === asked) s.fail("Crossings cannot be looked for", error);
  }
}
