/** Facts of a surface that the page finds itself: places, seams, parts, box. */

import type { Topology } from "pliant-client";

/** The surface as a user should know it, and what the tools need of it. */
export interface SurfaceReport {
  /** For each render vertex the number of its place; copies at a seam share one. */
  readonly placeOf: Uint32Array<ArrayBuffer>;
  readonly places: number;
  /** For each render vertex the number of its part. */
  readonly partOf: Uint32Array<ArrayBuffer>;
  /** Render vertices of each part. */
  readonly parts: readonly number[];
  /** Render vertices that share their place with another. */
  readonly seamVertices: number;
  /** Lowest and highest rest corner. */
  readonly box: { readonly min: readonly [number, number, number]; readonly max: readonly [number, number, number] };
  /** Length of the box's diagonal. */
  readonly diagonal: number;
}

/** Inspects a surface once, after it was opened or its topology changed. */
export function reportOf({ positions, indices }: Topology): SurfaceReport {
  const vertices = positions.length / 3;
  const { placeOf, places } = placesOf(positions);
  const roots = new Sets(places);
  for (let k = 0; k < indices.length; k += 3) {
    const a = placeOf[indices[k] as number] as number;
    roots.join(a, placeOf[indices[k + 1] as number] as number);
    roots.join(a, placeOf[indices[k + 2] as number] as number);
  }
  const numberOf = new Map<number, number>();
  const partOf = new Uint32Array(vertices);
  const parts: number[] = [];
  for (let v = 0; v < vertices; v++) {
    const root = roots.find(placeOf[v] as number);
    let part = numberOf.get(root);
    if (part === undefined) {
      part = parts.length;
      numberOf.set(root, part);
      parts.push(0);
    }
    partOf[v] = part;
    parts[part] = (parts[part] as number) + 1;
  }
  const copies = new Uint32Array(places);
  for (const place of placeOf) copies[place] = (copies[place] as number) + 1;
  let seamVertices = 0;
  for (const place of placeOf) if ((copies[place] as number) > 1) seamVertices += 1;
  return { placeOf, places, partOf, parts, seamVertices, ...boxOf(positions) };
}

/** The box around all vertices. */
export function boxOf(positions: Float32Array): Pick<SurfaceReport, "box" | "diagonal"> {
  const min: [number, number, number] = [Infinity, Infinity, Infinity];
  const max: [number, number, number] = [-Infinity, -Infinity, -Infinity];
  for (let k = 0; k < positions.length; k += 3) {
    for (let c = 0; c < 3; c++) {
      const x = positions[k + c] as number;
      if (x < (min[c] as number)) min[c] = x;
      if (x > (max[c] as number)) max[c] = x;
    }
  }
  const diagonal = Math.hypot(max[0] - min[0], max[1] - min[1], max[2] - min[2]);
  return { box: { min, max }, diagonal };
}

/** Numbers places by equal bits, with an open hash table: a `Map` of strings is too slow for a million vertices. */
export function placesOf(positions: Float32Array): { placeOf: Uint32Array<ArrayBuffer>; places: number } {
  const vertices = positions.length / 3;
  // Minus zero and zero are one place.
  const plain = positions.map((x) => x + 0);
  const bits = new Uint32Array(plain.buffer);
  const size = 2 ** Math.ceil(Math.log2(Math.max(16, vertices * 2)));
  const slots = new Int32Array(size).fill(-1);
  const firstOf: number[] = [];
  const placeOf = new Uint32Array(vertices);
  for (let v = 0; v < vertices; v++) {
    const [a, b, c] = [bits[v * 3] as number, bits[v * 3 + 1] as number, bits[v * 3 + 2] as number];
    let slot = (Math.imul(a, 73856093) ^ Math.imul(b, 19349663) ^ Math.imul(c, 83492791)) >>> 0;
    slot = Math.imul(slot ^ (slot >>> 15), 0x2c1b3c6d) & (size - 1);
    for (;;) {
      const place = slots[slot] as number;
      if (place < 0) {
        slots[slot] = placeOf[v] = firstOf.length;
        firstOf.push(v);
        break;
      }
      const w = (firstOf[place] as number) * 3;
      if (bits[w] === a && bits[w + 1] === b && bits[w + 2] === c) {
        placeOf[v] = place;
        break;
      }
      slot = (slot + 1) & (size - 1);
    }
  }
  return { placeOf, places: firstOf.length };
}

/** Sets that merge (union-find with path halving). */
class Sets {
  private readonly parent: Uint32Array;
  constructor(size: number) {
    this.parent = Uint32Array.from({ length: size }, (_, k) => k);
  }
  find(k: number): number {
    const { parent } = this;
    while (parent[k] !== k) {
      parent[k] = parent[parent[k] as number] as number;
      k = parent[k] as number;
    }
    return k;
  }
  join(a: number, b: number): void {
    const [ra, rb] = [this.find(a), this.find(b)];
    if (ra < rb) this.parent[rb] = ra;
    else this.parent[ra] = rb;
  }
}
