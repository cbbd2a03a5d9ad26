/** Shows places that the server names: the camera goes there, a ring marks them. */

import { Vector3 } from "three";
import type { Place } from "../model/warnings.ts";
import * as s from "./signals.ts";
import { toPage } from "./space.ts";
import { view } from "./view.ts";

/** How much of the model's diagonal is seen around a place. */
const AROUND = 0.12;

/** Looks at a place from where the surface faces. */
export function showPlace(place: Place): void {
  const { stage, pointer } = view();
  const { surface } = stage;
  const open = s.doc.peek();
  if (surface === undefined || open === undefined) return;
  // Vertices are where the shape is now; a point is told at rest.
  const at = "vertex" in place ? new Vector3().fromArray(surface.positions, place.vertex * 3) : new Vector3(...toPage([place.point[0], place.point[1], place.point[2]]));
  if (![at.x, at.y, at.z].every(Number.isFinite)) return;
  stage.lookAt(at, open.report.diagonal * AROUND, "vertex" in place ? surface.normalOf(place.vertex) : undefined);
  pointer.show(at);
}
