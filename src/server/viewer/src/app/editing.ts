/** Edits of the model, where the server has them. */

import { type Edit, PliantError, regionOf, schema } from "pliant-client";
import { AT_REST, heldAfter } from "../model/handles.ts";
import { otherPlaces } from "../model/warnings.ts";
import { count } from "../model/words.ts";
import { adoptHandles } from "./handling.ts";
import { isStale } from "./following.ts";
import { bringBack } from "./intermission.ts";
import { holdBeforeEdits, holdRest, keepDocument, reload } from "./opening.ts";
import { refreshHistory, remember } from "./past.ts";
import { repaint } from "./painting.ts";
import * as s from "./signals.ts";
import { origin } from "./space.ts";
import { beginHere, committing } from "./steps.ts";

/** An edit as the schema has it. */
export type Operation = NonNullable<Edit["operation"]>;

export interface CutChoice {
  readonly keep: "BOTH" | "ABOVE" | "BELOW";
  readonly fill: boolean;
}

/** Cuts along the plane that is shown. */
export async function cut({ keep, fill }: CutChoice): Promise<void> {
  const shown = s.cutPlane.peek();
  if (shown === undefined) return;
  const along = origin().reduce((sum, value, k) => sum + value * (shown.normal[k] ?? 0), 0);
  const plane = { ...shown, offset: shown.offset + along };
  await edit("Cutting", { case: "cut", value: { plane, keep: schema.EditRequest_Cut_Keep[keep], fill } });
  s.cutPlane.value = undefined;
}

/** Evens out triangles of the selection, to the chosen length of edges or where stretch asks for it. */
export async function remesh(): Promise<void> {
  const { remeshLength: edgeLength } = s.settings.peek();
  await edit("Remeshing", { case: "remesh", value: { ...region(), ...(edgeLength > 0 ? { edgeLength } : { auto: true }) } });
}

/** The selection as a region; without one there is none, which means the whole model. */
export function region(): { region?: ReturnType<typeof regionOf> } {
  const marks = s.selection.peek();
  const found: number[] = [];
  for (let v = 0; v < marks.length; v++) if (marks[v] === 1) found.push(v);
  return found.length === 0 ? {} : { region: regionOf(found) };
}

/** Carries out an edit of the shape as it is: one commit, which is called `what`. Without an answer, nothing was changed. */
export async function edit(what: string, operation: Operation): Promise<schema.EditResult | undefined> {
  const open = s.doc.peek();
  if (open === undefined) return undefined;
  bringBack();
  if (await isStale(what)) return undefined;
  const control = new AbortController();
  const busy: s.Busy = { title: what, cancel: () => control.abort() };
  s.busy.value = busy;
  const onWork = ({ stage, fraction }: schema.Work): void => {
    if (s.busy.peek() !== undefined) s.busy.value = { ...busy, detail: stage, fraction };
  };
  return committing(() => carryOut(open, what, open.session.edit({ operation }, { signal: control.signal, onWork })));
}

async function carryOut(open: s.Document, what: string, answer: Promise<schema.EditResult>): Promise<schema.EditResult | undefined> {
  try {
    const result = await answer;
    holdBeforeEdits();
    holdRest();
    const facts = await open.session.refresh();
    const former = s.handles.peek();
    await refreshHistory();
    await reload(open.session, open.name);
    const indices = s.doc.peek()?.topology.indices ?? new Uint32Array();
    const count = (s.doc.peek()?.topology.positions.length ?? 0) / 3;
    // What you see has become the rest shape, and handles are at rest again.
    const known = former.map((handle) => ({
      ...handle,
      pose: AT_REST,
      vertices: handle.vertices === undefined ? undefined : heldAfter(handle.vertices, result.kept, indices, count),
    }));
    adoptHandles(facts, known);
    const nothing = isNothing(result);
    remember(result.revision, s.handles.peek(), nothing ? `${what}: nothing changed` : what);
    beginHere();
    repaint();
    void keepDocument();
    s.note("info", nothing ? `${what} changed nothing` : `${what}: done`, nothing ? result.warnings[0]?.message : outcomeOf(result));
    for (const warning of nothing ? [] : result.warnings) s.note("info", warning.message, otherPlaces(warning));
    return result;
  } catch (error) {
    if (error instanceof PliantError && error.isUnimplemented) s.editsRefused.value = error.message;
    else s.fail(`${what} failed`, error);
    return undefined;
  } finally {
    s.busy.value = undefined;
  }
}

/** Whether an edit had nothing to do: each operation has a warning that says so. */
function isNothing({ warnings, unintersect }: schema.EditResult): boolean {
  return warnings.some(({ code }) => code.endsWith("-nothing")) || unintersect?.crossingsBefore === 0n;
}

/** What an edit came to, in numbers. */
function outcomeOf({ before, after, unintersect, wrap }: schema.EditResult): string {
  if (unintersect !== undefined) return `${count(unintersect.crossingsBefore)} → ${count(unintersect.crossings)} pairs of triangles cross`;
  if (wrap?.toTarget !== undefined) return `95 of 100 vertices lie within ${(wrap.toTarget.p95 * 100).toPrecision(2)} % of the target's size`;
  return `${count(before?.faces)} → ${count(after?.faces)} triangles`;
}
