/** Curves and lattices: the points of the active handle's guide are drawn, and dragged. */

import { effect } from "@preact/signals";
import type { Vector } from "pliant-client";
import { type HandleState, colourOf } from "../model/handles.ts";
import type { DrawnJoint } from "../scene/joints.ts";
import { commitPoses, dragTo, giveUpDrag } from "./dragging.ts";
import { onScreen } from "./intermission.ts";
import * as s from "./signals.ts";
import { view } from "./view.ts";

/** The handle and its pose when the drag under way began. */
let began: HandleState | undefined;

/** Draws the points of the active handle's guide. */
export function installLeading(): void {
  effect(() => {
    const handle = onScreen.value === undefined ? s.activeHandle.value : undefined;
    const guide = handle?.guide;
    if (handle === undefined || guide === undefined) return view().controls.show([], []);
    const colour = colourOf(handle).reduce((sum, part) => sum * 256 + part, 0);
    const points = (handle.pose.places ?? guide.rest).map((at, k): DrawnJoint => ({ name: String(k), at, colour }));
    view().controls.show(points, guide.links.map(([a, b]) => [String(a), String(b)]));
  });
}

/** Gives up the drag of a point: the guide is as it was. Whether there was one. */
export function giveUpLeading(): boolean {
  if (began === undefined) return false;
  const { id, pose } = began;
  began = undefined;
  view().controls.letGo();
  s.dragging.value = false;
  void giveUpDrag(id, pose);
  return true;
}

function moved(name: string, at: Vector): void {
  const handle = s.activeHandle.peek();
  const places = handle?.pose.places ?? handle?.guide?.rest;
  const k = Number(name);
  const before = places?.[k];
  if (handle === undefined || places === undefined || before === undefined) return;
  // A click moves nothing.
  if (before.every((x, axis) => x === at[axis])) return;
  began ??= handle;
  s.dragging.value = true;
  dragTo(handle.id, { ...handle.pose, places: places.map((place, other) => (other === k ? at : place)) });
}

function dropped(): void {
  const handle = began;
  if (handle === undefined) return;
  began = undefined;
  s.dragging.value = false;
  void commitPoses([handle.id]);
}

export const controlEvents = { moved, dropped };
