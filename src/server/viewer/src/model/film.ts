/** The frames of an animation as the page keeps them, and how much room they take. */

import type { Vector } from "pliant-client";
import { rotated } from "./handles.ts";

/** Where the root bone has carried the model: a point p of the frame is at rotation p + translation. */
export interface RootMotion {
  readonly translation: readonly number[];
  /** Unit quaternion x, y, z, w. */
  readonly rotation: readonly number[];
}

export interface FilmFrame {
  /** Its number in the animation. */
  readonly index: number;
  /** Seconds of the clip. */
  readonly time: number;
  readonly root: RootMotion;
  /** x, y, z per render vertex, as the root bone sees them. */
  readonly positions: Float32Array<ArrayBuffer>;
}

/** Bytes of frames that a page keeps. Browsers end pages that want much more. */
export const MOST_FILM_BYTES = 512 << 20;

/** Bytes of so many frames. */
export function filmBytes(frames: number, vertices: number): number {
  return frames * vertices * 12;
}

/** How often frames can be taken so that all of the animation fits: every second, every third… */
export function everyThatFits(frames: number, vertices: number): number {
  const fitting = Math.max(1, Math.floor(MOST_FILM_BYTES / Math.max(1, filmBytes(1, vertices))));
  return Math.ceil(frames / fitting);
}

/** The frame that is shown at a time: the last one that is not after it. */
export function frameAt(frames: readonly FilmFrame[], seconds: number): number {
  let [low, high] = [0, frames.length];
  while (low + 1 < high) {
    const middle = (low + high) >> 1;
    if ((frames[middle] as FilmFrame).time <= seconds + 1e-9) low = middle;
    else high = middle;
  }
  return low;
}

/** Seconds from one frame to the next. */
export function frameSeconds(frames: readonly FilmFrame[]): number {
  const [first, last] = [frames[0], frames.at(-1)];
  return first === undefined || last === undefined || frames.length < 2 ? 0 : (last.time - first.time) / (frames.length - 1);
}

/** A motion of places that are relative to `origin`. */
export function around([ox, oy, oz]: Vector, { translation, rotation }: RootMotion): RootMotion {
  const [x = 0, y = 0, z = 0, w = 1] = rotation;
  const [tx, ty, tz] = rotated([x, y, z, w], [ox, oy, oz]);
  const [dx = 0, dy = 0, dz = 0] = translation;
  return { translation: [tx + dx - ox, ty + dy - oy, tz + dz - oz], rotation };
}

/** Writes positions where a motion carries them; `out` may be the same list. */
export function carry(positions: Float32Array, { translation, rotation }: RootMotion, out: Float32Array): void {
  const [tx = 0, ty = 0, tz = 0] = translation;
  const [x = 0, y = 0, z = 0, w = 1] = rotation;
  const [xx, xy, xz] = [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)];
  const [yx, yy, yz] = [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)];
  const [zx, zy, zz] = [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)];
  for (let k = 0; k < positions.length; k += 3) {
    const a = positions[k] as number;
    const b = positions[k + 1] as number;
    const c = positions[k + 2] as number;
    out[k] = xx * a + xy * b + xz * c + tx;
    out[k + 1] = yx * a + yy * b + yz * c + ty;
    out[k + 2] = zx * a + zy * b + zz * c + tz;
  }
}

/** The motion that takes a motion back. */
export function inverse({ translation, rotation }: RootMotion): RootMotion {
  const [x = 0, y = 0, z = 0, w = 1] = rotation;
  const back = { translation: [0, 0, 0], rotation: [-x, -y, -z, w] };
  const moved = Float32Array.from(translation);
  carry(moved, back, moved);
  return { ...back, translation: Array.from(moved, (value) => -value) };
}
