/**
 * Rotations with turns. A quaternion forgets how often something was turned; a rotation vector (axis times angle) does
 * not. `HandlePose.rotationVector` takes any number of turns, so a drag must keep count.
 */

/** x, y, z. */
export type Vector = readonly [number, number, number];
/** x, y, z, w, of unit length. */
export type Quaternion = readonly [number, number, number, number];

/** The quaternion of a rotation vector. */
export function quaternionOf(vector: Vector): Quaternion {
  const angle = Math.hypot(...vector);
  if (angle < 1e-12) {
    return [vector[0] / 2, vector[1] / 2, vector[2] / 2, 1];
  }
  const s = Math.sin(angle / 2) / angle;
  return [vector[0] * s, vector[1] * s, vector[2] * s, Math.cos(angle / 2)];
}

/**
 * The rotation vector of `rotation` that lies nearest to `previous`. Called for every step of a drag, it counts turns:
 * past 180° the angle goes on growing instead of coming back from the other side.
 */
export function nearestRotationVector(rotation: Quaternion, previous: Vector): Vector {
  const [x, y, z, w] = rotation;
  const s = Math.hypot(x, y, z);
  const turn = 2 * Math.PI;
  const before = Math.hypot(...previous);
  let axis: Vector;
  let angle: number;
  if (s < 1e-9) {
    // Whole turns have no axis of their own; they keep the one that led to them.
    if (before < 1e-9) {
      return [0, 0, 0];
    }
    axis = [previous[0] / before, previous[1] / before, previous[2] / before];
    angle = w < 0 ? turn : 0;
  } else {
    axis = [x / s, y / s, z / s];
    angle = 2 * Math.atan2(s, w);
  }
  const along = previous[0] * axis[0] + previous[1] * axis[1] + previous[2] * axis[2];
  angle += turn * Math.round((along - angle) / turn);
  return [axis[0] * angle, axis[1] * angle, axis[2] * angle];
}

/** An angle in whole turns and the rest in degrees, both with its sign. */
export function turnsOf(angle: number): { turns: number; degrees: number } {
  const degrees = (angle * 180) / Math.PI;
  // A hair below a whole turn is a whole turn to people.
  const turns = Math.trunc((degrees + Math.sign(degrees) * 0.05) / 360);
  return { turns, degrees: degrees - turns * 360 };
}
