/** Handles as the page keeps them, and how the schema says them. */

import { type Handle, type PoseEntry, type Quaternion, type Vector, nearestRotationVector, quaternionOf, regionOf, schema } from "pliant-client";
import { type Guide, flat, guideMessage } from "./guides.ts";

/** How a handle acts: dragged by the gizmo, fixed, or pulling with a finite strength. */
export type Hold = "grip" | "pin" | "soft";

/** Where a handle is. */
export interface HandlePose {
  readonly translation: Vector;
  /** Axis times angle; any number of turns. */
  readonly rotation: Vector;
  readonly scale: Vector;
  /** Whether the server finds the rotation; `rotation` is then where its search begins. */
  readonly freely: boolean;
  /** Of a handle with a guide, where its points are; nothing else of the pose counts then. In the rest shape without. */
  readonly places?: readonly Vector[] | undefined;
}

export const AT_REST: HandlePose = { translation: [0, 0, 0], rotation: [0, 0, 0], scale: [1, 1, 1], freely: false };

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
  /** The point that its pose is turned and scaled about. A handle keeps it while it has a pose. */
  readonly pivot: Vector;
  readonly stiffness: number;
  readonly falloff: { readonly radius: number; readonly kind: FalloffKind };
  readonly constrains: Constrains;
  readonly rigid: boolean;
  readonly pose: HandlePose;
  /** What leads its vertices, if anything does. */
  readonly guide?: Guide | undefined;
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

/** The handle as a schema message. Without a known region it has only the other fields. */
export function messageOf(handle: HandleState, origin: Vector): Handle & { id: string } {
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
    ...(handle.falloff.kind !== "NONE" && handle.falloff.radius > 0
      ? { falloff: { radius: handle.falloff.radius, kind: schema.Falloff_Kind[handle.falloff.kind] } }
      : {}),
    rigid: handle.rigid,
    ...(handle.guide === undefined ? {} : { guide: guideMessage(handle.guide, (place) => added(place, origin)) }),
    ...(isAtRest(handle.pose) ? {} : { pose: poseMessage(handle, origin) }),
  };
}

/** Its pose in the schema's words. */
export function entryOf(handle: Pick<HandleState, "id" | "pose" | "pivot" | "guide">, origin: Vector): PoseEntry {
  return { id: handle.id, pose: poseMessage(handle, origin) };
}

/** The pivot is said, because the server's default depends on all handles, and these come and go; what turns freely is held by its middle. */
function poseMessage({ pose, pivot: [x, y, z], guide }: Pick<HandleState, "pose" | "pivot" | "guide">, origin: Vector): NonNullable<PoseEntry["pose"]> {
  if (guide !== undefined) return { guide: { positions: flat((pose.places ?? guide.rest).map((place) => added(place, origin))) } };
  const [ox, oy, oz] = origin;
  const { translation, rotation, scale, freely } = pose;
  const turn = freely ? { freeRotation: true } : { pivot: [x + ox, y + oy, z + oz] };
  return { translation: [...translation], rotationVector: [...rotation], scale: [...scale], ...turn };
}

/**
 * A pose from the server, about the handle's pivot as the page has it. Fields that the server omits have rest
 * values. Of equivalent rotations, it is the one nearest to `before`, so that turns are kept.
 */
export function poseOf(told: schema.HandlePose | undefined, own: Vector, [ox, oy, oz]: Vector, before: HandlePose = AT_REST): HandlePose {
  if (told === undefined) return AT_REST;
  if (told.guide !== undefined) return { ...AT_REST, places: placesOf(told.guide.positions, [ox, oy, oz]) };
  const [x, y, z, w] = told.rotation;
  const rotation =
    told.rotation.length === 4
      ? nearestRotationVector([x ?? 0, y ?? 0, z ?? 0, w ?? 1], before.rotation)
      : vectorOf(told.rotationVector, AT_REST.rotation);
  const [size] = told.scale;
  const scale: Vector = told.scale.length === 1 && size !== undefined ? [size, size, size] : vectorOf(told.scale, AT_REST.scale);
  const translation = vectorOf(told.translation, AT_REST.translation);
  const pivot = vectorOf(told.pivot, [own[0] + ox, own[1] + oy, own[2] + oz]);
  const away: Vector = [pivot[0] - ox - own[0], pivot[1] - oy - own[1], pivot[2] - oz - own[2]];
  const turned = rotated(quaternionOf(rotation), [away[0] * scale[0], away[1] * scale[1], away[2] * scale[2]]);
  return {
    translation: [translation[0] + away[0] - turned[0], translation[1] + away[1] - turned[1], translation[2] + away[2] - turned[2]],
    rotation,
    scale,
    freely: told.freeRotation,
  };
}

/**
 * A handle dragged to `translation` from `pose`: it turns automatically, unless it was turned by hand or cannot turn.
 */
export function movesFreely({ constrains }: Pick<HandleState, "constrains">, pose: HandlePose): boolean {
  return constrains.position && constrains.rotation && (pose.freely || pose.rotation.every((x) => x === 0));
}

/** A pose of a handle that has turned freely by `turn` about its middle, held as it lies, about its pivot. */
export function heldPose(pose: HandlePose, turn: Vector, pivot: Vector, middle: Vector): HandlePose {
  const away: Vector = [pivot[0] - middle[0], pivot[1] - middle[1], pivot[2] - middle[2]];
  const turned = rotated(quaternionOf(turn), away);
  const [x, y, z] = pose.translation;
  return { ...pose, freely: false, rotation: turn, translation: [x + turned[0] - away[0], y + turned[1] - away[1], z + turned[2] - away[2]] };
}

/** Handles whose search for a rotation begins at these. */
export function searchingFrom(handles: readonly HandleState[], turns: ReadonlyMap<string, Vector>): readonly HandleState[] {
  return handles.map((handle) => {
    const rotation = handle.pose.freely ? turns.get(handle.id) : undefined;
    return rotation === undefined ? handle : { ...handle, pose: { ...handle.pose, rotation } };
  });
}

function added(a: Vector, b: Vector): Vector {
  return [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
}

function placesOf(numbers: readonly number[], [ox, oy, oz]: Vector): Vector[] {
  const places: Vector[] = [];
  for (let k = 0; k + 2 < numbers.length; k += 3) places.push([(numbers[k] as number) - ox, (numbers[k + 1] as number) - oy, (numbers[k + 2] as number) - oz]);
  return places;
}

function vectorOf(numbers: readonly number[], otherwise: Vector): Vector {
  const [x, y, z] = numbers;
  return x === undefined || y === undefined || z === undefined ? otherwise : [x, y, z];
}

/** v + 2w(q × v) + 2q × (q × v). */
export function rotated([x, y, z, w]: Quaternion, v: Vector): Vector {
  const cross = (b: Vector): Vector => [y * b[2] - z * b[1], z * b[0] - x * b[2], x * b[1] - y * b[0]];
  const once = cross(v);
  const twice = cross(once);
  return [v[0] + 2 * (w * once[0] + twice[0]), v[1] + 2 * (w * once[1] + twice[1]), v[2] + 2 * (w * once[2] + twice[2])];
}

/** Vertices under their numbers after an edit; those that are gone are left out. */
function carried(vertices: Uint32Array, runs: readonly schema.EditResult_Run[]): Uint32Array {
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

/**
 * The vertices of a handle after an edit: those that are left of it, and the new ones between them. A new vertex
 * follows its neighbours: it is held where no decided neighbour is free. The page paints this; the server has its own
 * list, which it does not return.
 */
export function heldAfter(vertices: Uint32Array, runs: readonly schema.EditResult_Run[], indices: Uint32Array, count: number): Uint32Array {
  const [UNKNOWN, FREE, HELD] = [0, 1, 2];
  const state = new Uint8Array(count);
  for (const { now, count: length } of runs) state.fill(FREE, now, now + length);
  for (const v of carried(vertices, runs)) state[v] = HELD;
  for (;;) {
    const next = new Map<number, number>();
    for (let k = 0; k < indices.length; k += 3) {
      for (let c = 0; c < 3; c++) {
        const v = indices[k + c] as number;
        if (state[v] !== UNKNOWN) continue;
        for (const other of [indices[k + ((c + 1) % 3)] as number, indices[k + ((c + 2) % 3)] as number]) {
          if (state[other] !== UNKNOWN && next.get(v) !== FREE) next.set(v, state[other] as number);
        }
      }
    }
    if (next.size === 0) break;
    for (const [v, decided] of next) state[v] = decided;
  }
  const found: number[] = [];
  for (let v = 0; v < count; v++) if (state[v] === HELD) found.push(v);
  return Uint32Array.from(found);
}

/** Whether a pose is none. */
export function isAtRest({ translation, rotation, scale, freely, places }: HandlePose): boolean {
  return !freely && places === undefined && [...translation, ...rotation].every((x) => x === 0) && scale.every((x) => x === 1);
}
