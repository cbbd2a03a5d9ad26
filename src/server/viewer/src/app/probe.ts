/** A window into the page for tests and for the console: `pliantViewer.positions()`. Reads, never writes. */

import { Vector3 } from "three";
import { animating, coming, isCompared } from "./animating.ts";
import { crossings } from "./crossing.ts";
import { paintedSoFar } from "./dragging.ts";
import { wardrobe } from "./dressing.ts";
import { linePoints } from "./lines.ts";
import { playing } from "./playing.ts";
import { rigging } from "./rigging.ts";
import * as s from "./signals.ts";
import { view } from "./view.ts";

export interface Probe {
  session(): string | undefined;
  /** x, y, z of what is drawn. */
  positions(): Float32Array;
  /** x, y, z of what is drawn in the left half, if something is. */
  beside(): Float32Array | undefined;
  handles(): { id: string; name: string; vertices: number[]; pose: unknown; pivot: readonly number[]; at: { x: number; y: number } | undefined }[];
  /** A vertex on the page, in CSS pixels. */
  place(vertex: number): { x: number; y: number } | undefined;
  /** Where the eye is, and what it looks at, in model space. */
  camera(): { eye: number[]; target: number[] };
  state(): {
    link: string;
    busy: boolean;
    selected: number;
    superseded: number;
    solveMs: number;
    vertices: number;
    /** Whether it is known what the model looks like, its clips, what could not be drawn. */
    dressed: boolean;
    clips: number;
    faults: number;
    /** Whether something is pointed at. */
    pointing: boolean;
    /** The time in the clip that is shown; below 0 without one. */
    seconds: number;
    /** The animation that is shown: frames that are there, that are wanted, the one on the screen. */
    animation: { kept: number; wanted: number; at: number; running: boolean; coming: boolean; compared: boolean } | null;
    /** Triangles that are marked as crossing others; -1 while none are looked for. */
    crossings: number;
    /** The points of the active handle's guide, on the page. */
    points: { at: readonly number[]; place: { x: number; y: number } | undefined }[];
    /** The points of the line that is drawn, on the page. */
    line: ({ x: number; y: number } | undefined)[];
    /** The joints of the rig that is shown, on the page. */
    rig: { name: string; score: number | null; doubtful: boolean; given: boolean; at: readonly number[]; place: { x: number; y: number } | undefined }[] | null;
    revision: string;
    /** Shapes painted since the page was loaded, and the milliseconds that decoding and shading them took. */
    painted: number;
    takenMs: number;
    /** The part of the gizmo under the pointer. */
    gizmoPart: string | null;
  };
}

declare global {
  interface Window {
    pliantViewer?: Probe;
  }
}

export function installProbe(): void {
  const shown = (): Float32Array => view().stage.surface?.positions ?? new Float32Array();
  const place = (point: Vector3): { x: number; y: number } | undefined => {
    const { stage } = view();
    const box = stage.canvas.getBoundingClientRect();
    const p = stage.project(point);
    return p && { x: p.x + box.left, y: p.y + box.top };
  };
  window.pliantViewer = {
    session: () => s.doc.peek()?.session.id,
    positions: shown,
    beside: () => view().stage.surfaces()[1]?.positions,
    handles: () =>
      s.handles.peek().map(({ id, name, vertices, pose, pivot }) => ({
        id,
        name,
        vertices: [...(vertices ?? [])],
        pose,
        pivot,
        at: place(new Vector3(...pivot).add(new Vector3(...pose.translation))),
      })),
    place: (vertex) => place(new Vector3().fromArray(shown(), vertex * 3)),
    camera: () => ({ eye: view().stage.camera.position.toArray(), target: view().stage.orbit.target.toArray() }),
    state: () => ({
      link: s.link.peek().state,
      busy: s.busy.peek() !== undefined,
      selected: s.selectedCount.peek(),
      superseded: s.superseded.peek(),
      solveMs: s.meters.peek()?.solveMs ?? 0,
      vertices: shown().length / 3,
      dressed: wardrobe.peek().dressed,
      clips: wardrobe.peek().clips.length,
      faults: wardrobe.peek().faults.length,
      pointing: view().pointer.isShown,
      seconds: playing.peek()?.seconds ?? -1,
      animation: animationNow(),
      crossings: crossings.peek()?.total ?? -1,
      points: ((handle) => (handle?.pose.places ?? handle?.guide?.rest ?? []).map((at) => ({ at: [...at], place: place(new Vector3(...at)) })))(s.activeHandle.peek()),
      line: linePoints.peek().map((at) => place(new Vector3(...at))),
      rig: rigging.peek()?.joints.map(({ name, score, doubtful, given, at }) => ({ name, score: score ?? null, doubtful, given, at, place: place(new Vector3(...at)) })) ?? null,
      revision: String(s.currentRevision.peek()),
      ...paintedSoFar(),
      gizmoPart: view().gizmo.hotPart,
    }),
  };
}

function animationNow(): ReturnType<Probe["state"]>["animation"] {
  const shown = animating.peek();
  if (shown === undefined) return null;
  const { kept, wanted, at, running } = shown;
  return { kept, wanted, at, running, coming: coming.peek() !== undefined, compared: isCompared.peek() };
}
