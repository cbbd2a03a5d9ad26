/** Which triangle a ray meets first, without an acceleration structure: the shape changes too often to keep one. */

import type * as THREE from "three";

/** Where a ray meets the surface. */
export interface Hit {
  readonly triangle: number;
  readonly distance: number;
  /** The render vertex of the triangle that lies nearest to the hit. */
  readonly vertex: number;
}

/** The first triangle on the ray (Möller and Trumbore), from either side. */
export function pick(ray: THREE.Ray, positions: Float32Array, indices: Uint32Array): Hit | undefined {
  const { x: ox, y: oy, z: oz } = ray.origin;
  const { x: dx, y: dy, z: dz } = ray.direction;
  let found = -1;
  let nearest = Infinity;
  let weights: [number, number] = [0, 0];
  for (let k = 0; k < indices.length; k += 3) {
    const a = (indices[k] as number) * 3;
    const b = (indices[k + 1] as number) * 3;
    const c = (indices[k + 2] as number) * 3;
    const ax = positions[a] as number;
    const ay = positions[a + 1] as number;
    const az = positions[a + 2] as number;
    const ux = (positions[b] as number) - ax;
    const uy = (positions[b + 1] as number) - ay;
    const uz = (positions[b + 2] as number) - az;
    const vx = (positions[c] as number) - ax;
    const vy = (positions[c + 1] as number) - ay;
    const vz = (positions[c + 2] as number) - az;
    const px = dy * vz - dz * vy;
    const py = dz * vx - dx * vz;
    const pz = dx * vy - dy * vx;
    const det = ux * px + uy * py + uz * pz;
    if (det === 0) continue;
    const inverse = 1 / det;
    const tx = ox - ax;
    const ty = oy - ay;
    const tz = oz - az;
    const u = (tx * px + ty * py + tz * pz) * inverse;
    if (!(u >= 0 && u <= 1)) continue;
    const qx = ty * uz - tz * uy;
    const qy = tz * ux - tx * uz;
    const qz = tx * uy - ty * ux;
    const v = (dx * qx + dy * qy + dz * qz) * inverse;
    if (!(v >= 0 && u + v <= 1)) continue;
    const t = (vx * qx + vy * qy + vz * qz) * inverse;
    if (t > 0 && t < nearest) {
      nearest = t;
      found = k;
      weights = [u, v];
    }
  }
  if (found < 0) return undefined;
  const [u, v] = weights;
  const corner = u + v < 0.5 ? 0 : u > v ? 1 : 2;
  return { triangle: found / 3, distance: nearest, vertex: indices[found + corner] as number };
}
