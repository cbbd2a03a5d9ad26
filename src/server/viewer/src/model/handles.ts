/** Handles as the page keeps them, and how the schema says them. */

import { type Handle, type PoseEntry, type Vector, regionOf, schema } from "pliant-client";

/** How a handle holds: dragged by the gizmo, kept at rest, or pulling with a finite strength. */
export type Hold = "grip" | "pin" | "soft";

/** Where a handle is. */
export interface HandlePose {
  readonly translation: Vector;
  /** Axis times angle; any number of turns. */
  readonly rotation: Vector;
  readonly scale: Vector;
}

export const AT_REST: HandlePose = { translation: [0, 0, 0], rotation: [0, 0, 0], scale: [1, 1, 1] };

/** What a handle constrains. */
export interface Constrains {
  readonly position: boolean;
  readonly rotation: boolean;
  readonly scale: boolean;
}

/** How a soft handle fades out. */
export type FalloffKind = "NONE" | "LINEAR" | "SMOOTH";

/** A handle. Never changed in place, so that history can keep old ones. */
export interface HandleState {
  readonly id: string;
  readonly name: string;
  /** Index into the palette. */
  readonly hue: number;
  readonly hold: Hold;
  /** Its render vertices, ascending; unknown for handles that were set elsewhere, or before an edit. */
  readonly vertices: Uint32Array | undefined;
  /** Render vertices that it holds, as the server counts. */
  readonly count: number;
  readonly centroid: Vector;
  readonly stiffness: number;
  readonly falloff: { readonly radius: number; readonly kind: FalloffKind };
  readonly constrains: Constrains;
  readonly rigid: boolean;
  readonly pose: HandlePose;
}

/** Colours of handles, the first ones far from the gizmo's axes, all far from the selection's amber. */
export const PALETTE: readonly (readonly [number, number, number])[] = [
  [52, 186, 206],
  [180, 138, 246],
  [228, 116, 178],
  [146, 186, 72],
  [84, 150, 250],
  [58, 186, 134],
  [232, 104, 110],
  [186, 150, 110],
];

/** Pins are all alike: they are where nothing happens. */
export const PIN_COLOUR: readonly [number, number, number] = [92, 104, 140];

/** The colour in which a handle's region is painted. */
export function colourOf({ hold, hue }: Pick<HandleState, "hold" | "hue">): readonly [number, number, number] {
  return hold === "pin" ? PIN_COLOUR : (PALETTE[hue % PALETTE.length] ?? PIN_COLOUR);
}

/** The handle in the schema's words. Without a known region only its other fields are told. */
export function messageOf(handle: HandleState): Handle & { id: string } {
  const { position, rotation, scale } = handle.constrains;
  const all = position && rotation && scale;
  const constrains = [
    ...(position ? [schema.Handle_Constrains.POSITION] : []),
    ...(rotation ? [schema.Handle_Constrains.ROTATION] : []),
    ...(scale ? [schema.Handle_Constrains.SCALE] : []),
  ];
  return {
    id: handle.id,
    ...(handle.vertices === undefined ? {} : { region: regionOf(handle.vertices) }),
    ...(all ? {} : { constrains }),
    ...(handle.hold === "soft" ? { stiffness: handle.stiffness } : {}),
    ...(handle.hold === "soft" && handle.falloff.kind !== "NONE" && handle.falloff.radius > 0
      ? { falloff: { radius: handle.falloff.radius, kind: schema.Falloff_Kind[handle.falloff.kind] } }
      : {}),
    rigid: handle.rigid,
    ...(isAtRest(handle.pose) ? {} : { pose: poseMessage(handle.pose) }),
  };
}

/** Its pose in the schema's words. */
export function entryOf({ id, pose }: Pick<HandleState, "id" | "pose">): PoseEntry {
  return { id, pose: poseMessage(pose) };
}

function poseMessage({ translation, rotation, scale }: HandlePose): NonNullable<PoseEntry["pose"]> {
  return { translation: [...translation], rotationVector: [...rotation], scale: [...scale] };
}

/** Vertices under their numbers after an edit; those that are gone are left out. */
export function carried(vertices: Uint32Array, runs: readonly schema.EditResult_Run[]): Uint32Array {
  const found: number[] = [];
  let at = 0;
  for (const vertex of vertices) {
    // Runs rise, and so do vertices.
    while (at < runs.length && (runs[at] as schema.EditResult_Run).was + (runs[at] as schema.EditResult_Run).count <= vertex) at += 1;
    const run = runs[at];
    if (run !== undefined && run.was <= vertex) found.push(vertex - run.was + run.now);
  }
  return Uint32Array.from(found).sort();
}

/** Whether a pose is none. */
export function isAtRest({ translation, rotation, scale }: HandlePose): boolean {
  return [...translation, ...rotation].every((x) => x === 0) && scale.every((x) => x === 1);
}
