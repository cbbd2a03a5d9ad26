/**
 * The page's own space: model space relative to the session's origin, where 32-bit numbers hold a model in map coordinates. All that is
 * drawn, picked and remembered is in it; what comes from the server or goes to it in model space passes here.
 */

import type { Vector } from "pliant-client";
import * as s from "./signals.ts";

/** Where the page's space has its origin in model space: at zero, but for models far away. */
export function origin(): Vector {
  return s.doc.peek()?.session.origin ?? [0, 0, 0];
}

/** A place in model space, in the page's. */
export function toPage([x, y, z]: Vector): Vector {
  const [ox, oy, oz] = origin();
  return [x - ox, y - oy, z - oz];
}

/** A place in the page's space, in model space. */
export function toModel([x, y, z]: Vector): Vector {
  const [ox, oy, oz] = origin();
  return [x + ox, y + oy, z + oz];
}
