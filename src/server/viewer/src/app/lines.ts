/** A line that is drawn on the surface, click by click, and becomes edges or a cut. */

import { effect, signal } from "@preact/signals";
import { type Vector, schema } from "pliant-client";
import { Vector3 } from "three";
import { pick } from "../scene/picking.ts";
import { edit } from "./editing.ts";
import * as s from "./signals.ts";
import { toModel } from "./space.ts";
import { did } from "./steps.ts";
import { view } from "./view.ts";

/** What a line becomes. */
export interface LineChoice {
  readonly cuts: boolean;
  /** It returns to its first point. */
  readonly closed: boolean;
  readonly keep: keyof typeof schema.EditRequest_Cut_Keep;
  /** The cut is closed by a cap. */
  readonly fill: boolean;
}

const COLOUR = 0xffb02e;

/** The points so far, in the page's space. */
export const linePoints = signal<readonly Vector[]>([]);
export const lineChoice = signal<LineChoice>({ cuts: false, closed: false, keep: "BOTH", fill: true });

/** Whether there are enough points. */
export function isLine(): boolean {
  return linePoints.value.length >= (lineChoice.value.closed ? 3 : 2);
}

/** Draws the line while its tool is taken; another tool and another surface drop it. */
export function installLines(): void {
  effect(() => {
    void [s.doc.value, s.tool.value];
    linePoints.value = [];
  });
  effect(() => {
    const points = linePoints.value;
    const last = points.length - 1;
    const pairs = points.slice(1).map((_, k): [string, string] => [String(k), String(k + 1)]);
    if (lineChoice.value.closed && last > 1) pairs.push([String(last), "0"]);
    view().line.show(points.map((at, k) => ({ name: String(k), at, colour: COLOUR })), pairs);
  });
}

/** Adds the place of the surface at a place of the canvas. */
export function addPoint(x: number, y: number): void {
  const at = surfaceAt(x, y);
  if (at !== undefined) linePoints.value = [...linePoints.peek(), at];
}

/** Whether there was one. */
export function removeLastPoint(): boolean {
  const points = linePoints.peek();
  linePoints.value = points.slice(0, -1);
  return points.length > 0;
}

/** Makes edges of the line, and selects their vertices, or cuts along it. */
export async function applyLine(): Promise<void> {
  if (!isLine()) return;
  const points = linePoints.peek().flatMap((at) => [...toModel(at)]);
  const { cuts, closed, keep, fill } = lineChoice.peek();
  const result = cuts
    ? await edit("Cutting", { case: "cut", value: { polyline: points, closed, keep: schema.EditRequest_Cut_Keep[keep], fill } })
    : await edit("Inserting a line", { case: "insertCurve", value: { points, closed } });
  if (result === undefined) return;
  s.tool.value = "orbit";
  const placeOf = s.doc.peek()?.report.placeOf;
  if (cuts || placeOf === undefined) return;
  const places = new Set(result.curve.map((vertex) => placeOf[vertex]));
  s.selection.value = Uint8Array.from(placeOf, (place) => (places.has(place) ? 1 : 0));
  did("Line selected");
}

/** A point is dragged over the surface; beside it, it stays. */
function moved(name: string, to: Vector): void {
  const seen = view().stage.project(new Vector3(...to));
  const at = seen && surfaceAt(seen.x, seen.y);
  if (at !== undefined) linePoints.value = linePoints.peek().map((point, k) => (String(k) === name ? at : point));
}

function surfaceAt(x: number, y: number): Vector | undefined {
  const { stage } = view();
  if (stage.surface === undefined) return undefined;
  const ray = stage.rayThrough(x, y);
  const hit = pick(ray, stage.surface.positions, stage.surface.topology.indices);
  const at = hit && ray.at(hit.distance, new Vector3());
  return at && [at.x, at.y, at.z];
}

export const lineEvents = { moved, dropped: (): void => undefined };
