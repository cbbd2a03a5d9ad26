/** Moving, turning and scaling a handle along an axis, in a plane or freely: from an amount to the pose. No page, no three.js. */

import { type Vector, nearestRotationVector, quaternionOf } from "pliant-client";
import { type HandlePose, rotated } from "./handles.ts";

/** What is done to a handle; the tools that do it have the same names. */
export type TransformKind = "move" | "rotate" | "scale";

/** What limits a transform: one axis, or the plane across it. */
export interface Lock {
  /** 0 to 2: X, Y, Z. */
  readonly axis: number;
  readonly plane: boolean;
  /** Whether it is the handle's own axis, which has turned with it, rather than the model's. */
  readonly own: boolean;
}

/** Scales below this would turn a region into nothing, or inside out. */
export const LEAST_SCALE = 0.02;

/** Turns above this lose their count from one quaternion to the next. */
const COUNTED_TURN = Math.PI / 2;

const UNITS: readonly Vector[] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];

/** The axis of a lock in the page's space, for a handle that has turned so. */
export function axisOf({ axis, own }: Lock, rotation: Vector): Vector {
  const unit = UNITS[axis] ?? [1, 0, 0];
  return own ? rotated(quaternionOf(rotation), unit) : unit;
}

/** A number at the nearest multiple of a step; unchanged without one. */
export function snapped(value: number, step: number | undefined): number {
  return step === undefined ? value : Number((Math.round(value / step) * step).toPrecision(12));
}

/** A pose moved by a vector. */
export function movedBy(pose: HandlePose, [x, y, z]: Vector): HandlePose {
  const { translation } = pose;
  return { ...pose, translation: [translation[0] + x, translation[1] + y, translation[2] + z] };
}

/** A pose turned about an axis of unit length by an angle in radians; any number of turns counts. */
export function turnedBy(pose: HandlePose, axis: Vector, angle: number): HandlePose {
  const steps = Math.max(1, Math.ceil(Math.abs(angle) / COUNTED_TURN));
  const [ax, ay, az, aw] = quaternionOf([axis[0] * (angle / steps), axis[1] * (angle / steps), axis[2] * (angle / steps)]);
  let { rotation } = pose;
  for (let k = 0; k < steps; k++) {
    const [x, y, z, w] = quaternionOf(rotation);
    rotation = nearestRotationVector(
      [
        aw * x + ax * w + ay * z - az * y,
        aw * y - ax * z + ay * w + az * x,
        aw * z + ax * y - ay * x + az * w,
        aw * w - ax * x - ay * y - az * z,
      ],
      rotation,
    );
  }
  return { ...pose, rotation };
}

/** A pose scaled by a factor: in all directions, along the axis of a lock, or across it. */
export function scaledBy(pose: HandlePose, factor: number, lock: Lock | undefined): HandlePose {
  const scale = pose.scale.map((size, k) => {
    const takes = lock === undefined || (k === lock.axis) !== lock.plane;
    return takes ? Math.min(1 / LEAST_SCALE, Math.max(LEAST_SCALE, size * factor)) : size;
  });
  return { ...pose, scale: scale as unknown as Vector };
}
