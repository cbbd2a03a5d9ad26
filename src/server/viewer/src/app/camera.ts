/** A camera that follows what walks: it goes across the ground as far as the model does, so that the model stays in the picture. */

import { effect, signal } from "@preact/signals";
import type { Surface } from "../scene/surface.ts";
import { onScreen } from "./intermission.ts";
import { view } from "./view.ts";

/** Whether the camera follows clips and animations. */
export const cameraFollows = signal(false);

/** Where the middle of the model was in the frame before. */
let last: { readonly surface: Surface; readonly x: number; readonly z: number } | undefined;

/** A frame of a clip or an animation is shown. */
export function frameShown(surface: Surface): void {
  const [x, z] = [mean(surface.positions, 0), mean(surface.positions, 2)];
  if (cameraFollows.peek() && last?.surface === surface) view().stage.shift(x - last.x, z - last.z);
  last = { surface, x, z };
}

/** The mean of one coordinate: arms and legs that swing move it less than they move the box. */
function mean(positions: Float32Array, from: number): number {
  let sum = 0;
  for (let k = from; k < positions.length; k += 3) sum += positions[k] as number;
  return sum / Math.max(1, positions.length / 3);
}

/** Looks at the model where it is as soon as it is to be followed. */
export function installCamera(): void {
  effect(() => {
    if (cameraFollows.value && onScreen.peek() !== undefined) view().stage.frame();
  });
  effect(() => {
    if (onScreen.value !== undefined) return;
    last = undefined;
    // The pose that comes back is where it was, and the camera may be elsewhere.
    const { stage } = view();
    if (cameraFollows.peek() && stage.surface !== undefined && !stage.sees(stage.surface.bounds().center)) stage.frame();
  });
}
