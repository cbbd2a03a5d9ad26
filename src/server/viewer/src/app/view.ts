/** The scene and its objects, once the canvas is there. Actions and tools reach them here. */

import type { Axes } from "../scene/axes.ts";
import type { Gizmo } from "../scene/gizmo.ts";
import type { Joints } from "../scene/joints.ts";
import type { Markers } from "../scene/markers.ts";
import type { Overlay } from "../scene/overlay.ts";
import type { Pointer } from "../scene/pointer.ts";
import type { Stage } from "../scene/stage.ts";

export interface View {
  readonly stage: Stage;
  readonly gizmo: Gizmo;
  /** Lines along which the active handle is moved. */
  readonly axes: Axes;
  readonly markers: Markers;
  readonly joints: Joints;
  /** Points of the active handle's guide. */
  readonly controls: Joints;
  /** Points of the line that is drawn. */
  readonly line: Joints;
  readonly overlay: Overlay;
  readonly pointer: Pointer;
}

let current: View | undefined;

export function setView(view: View): void {
  current = view;
}

/** The view; it exists before anything can be opened. */
export function view(): View {
  if (current === undefined) throw new Error("the canvas is not there yet");
  return current;
}
