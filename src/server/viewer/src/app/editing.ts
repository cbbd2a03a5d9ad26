/** Operations that change the topology, where the server has them. */

import { type Edit, PliantError, regionOf, schema } from "pliant-client";
import { AT_REST, heldAfter } from "../model/handles.ts";
import { otherPlaces } from "../model/warnings.ts";
import { adoptHandles } from "./handling.ts";
import { isStale } from "./following.ts";
import { bringBack } from "./intermission.ts";
import { holdBeforeEdits, holdRest, keepDocument, reload } from "./opening.ts";
import { refreshHistory, remember } from "./past.ts";
import { repaint } from "./painting.ts";
import * as s from "./signals.ts";
import { origin } from "./space.ts";
import { beginHere, committing } from "./steps.ts";

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
  await edit("Cutting", {
    operation: { case: "cut", value: { plane, keep: schema.EditRequest_Cut_Keep[keep], fill } },
  });
  s.cutPlane.value = undefined;
}

/** Splits triangles of the selection, or of everything. */
export async function subdivide(scheme: "LOOP" | "MIDPOINT"): Promise<void> {
  await edit("Subdividing", {
    operation: { case: "subdivide", value: { ...region(), scheme: schema.EditRequest_Subdivide_Scheme[scheme] } },
  });
}

/** Evens out triangles of the selection, to the chosen length of edges or where stretch asks for it. */
export async function remesh(): Promise<void> {
  const { remeshLength: edgeLength } = s.settings.peek();
  await edit("Remeshing", {
    operation: {
      case: "remesh",
      value: { ...region(), ...(edgeLength > 0 ? { edgeLength } : { auto: true }) },
    },
  });
}

/** Takes wrinkles off the selection or everything, or evens its triangles where they are. */
export async function smooth(kind: "SMOOTH" | "RELAX"): Promise<void> {
  await edit(kind === "RELAX" ? "Relaxing" : "Smoothing", {
    operation: { case: "smooth", value: { ...region(), kind: schema.EditRequest_Smooth_Kind[kind] } },
  });
}

/** The selection as a region; without one there is none, which means the whole model. */
function region(): { region?: ReturnType<typeof regionOf> } {
  const marks = s.selection.peek();
  const found: number[] = [];
  for (let v = 0; v < marks.length; v++) if (marks[v] === 1) found.push(v);
  return found.length === 0 ? {} : { region: regionOf(found) };
}

async function edit(what: string, operation: Edit): Promise<void> {
  const open = s.doc.peek();
  if (open === undefined) return;
  bringBack();
  if (await isStale(what)) return;
  s.busy.value = { title: what };
  await committing(() => carryOut(open, what, operation));
}

async function carryOut(open: s.Document, what: string, operation: Edit): Promise<void> {
  try {
    const result = await open.session.edit(operation);
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
    remember(result.revision, s.handles.peek(), what);
    beginHere();
    repaint();
    void keepDocument();
    const { before, after } = result;
    s.note("info", `${what}: done`, `${before?.faces.toLocaleString("en")} → ${after?.faces.toLocaleString("en")} triangles`);
    for (const warning of result.warnings) s.note("info", warning.message, otherPlaces(warning));
  } catch (error) {
    if (error instanceof PliantError && error.isUnimplemented) s.editsRefused.value = error.message;
    else s.fail(`${what} failed`, error);
  } finally {
    s.busy.value = undefined;
  }
}
