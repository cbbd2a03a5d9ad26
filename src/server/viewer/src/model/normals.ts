/**
 * Normals of a moving surface. Copies of a vertex at a texture seam are shaded as one; copies at a hard edge, where the
 * model has different normals, are not.
 */

import type { SurfaceReport } from "./report.ts";
import type { Topology } from "pliant-client";

/** For each render vertex the number of the group that shares a normal. */
export interface Smoothing {
  readonly groupOf: Uint32Array<ArrayBuffer>;
  readonly sums: Float32Array<ArrayBuffer>;
}

/** Forms the groups: the same place, and nearly the same rest normal. */
export function smoothingOf({ normals }: Topology, { placeOf, places }: SurfaceReport): Smoothing {
  if (normals === undefined) {
    return { groupOf: placeOf, sums: new Float32Array(places * 3) };
  }
  const groupOf = new Uint32Array(placeOf.length);
  // Groups of a place form a list: the newest group of the place, and the one before each group.
  const newest = new Int32Array(places).fill(-1);
  const before: number[] = [];
  const speaker: number[] = [];
  for (let v = 0; v < placeOf.length; v++) {
    const place = placeOf[v] as number;
    let group = newest[place] as number;
    while (group >= 0 && !alike(normals, v, speaker[group] as number)) group = before[group] as number;
    if (group < 0) {
      group = speaker.length;
      before.push(newest[place] as number);
      speaker.push(v);
      newest[place] = group;
    }
    groupOf[v] = group;
  }
  return { groupOf, sums: new Float32Array(speaker.length * 3) };
}

/** Within about 18°, above what quantised normals are off and below what modellers call a hard edge. */
function alike(normals: Float32Array, a: number, b: number): boolean {
  let dot = 0;
  for (let c = 0; c < 3; c++) dot += (normals[a * 3 + c] as number) * (normals[b * 3 + c] as number);
  return dot > 0.95;
}

/** Area-weighted normals of the shape into `out`. */
export function updateNormals(
  positions: Float32Array,
  indices: Uint32Array,
  { groupOf, sums }: Smoothing,
  out: Float32Array,
): void {
  sums.fill(0);
  for (let k = 0; k < indices.length; k += 3) {
    const i = indices[k] as number;
    const j = indices[k + 1] as number;
    const l = indices[k + 2] as number;
    const x = positions[i * 3] as number;
    const y = positions[i * 3 + 1] as number;
    const z = positions[i * 3 + 2] as number;
    const ux = (positions[j * 3] as number) - x;
    const uy = (positions[j * 3 + 1] as number) - y;
    const uz = (positions[j * 3 + 2] as number) - z;
    const vx = (positions[l * 3] as number) - x;
    const vy = (positions[l * 3 + 1] as number) - y;
    const vz = (positions[l * 3 + 2] as number) - z;
    const nx = uy * vz - uz * vy;
    const ny = uz * vx - ux * vz;
    const nz = ux * vy - uy * vx;
    const a = (groupOf[i] as number) * 3;
    const b = (groupOf[j] as number) * 3;
    const c = (groupOf[l] as number) * 3;
    sums[a]! += nx;
    sums[a + 1]! += ny;
    sums[a + 2]! += nz;
    sums[b]! += nx;
    sums[b + 1]! += ny;
    sums[b + 2]! += nz;
    sums[c]! += nx;
    sums[c + 1]! += ny;
    sums[c + 2]! += nz;
  }
  for (let v = 0; v < groupOf.length; v++) {
    const g = (groupOf[v] as number) * 3;
    const x = sums[g] as number;
    const y = sums[g + 1] as number;
    const z = sums[g + 2] as number;
    const scale = 1 / (Math.sqrt(x * x + y * y + z * z) || 1);
    out[v * 3] = x * scale;
    out[v * 3 + 1] = y * scale;
    out[v * 3 + 2] = z * scale;
  }
}
