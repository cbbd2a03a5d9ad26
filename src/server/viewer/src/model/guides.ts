/** Guides of handles: a curve or a lattice whose points are dragged. Places are in the page's space. */

import { type Handle, type Vector } from "pliant-client";

export type GuideKind = "curve" | "lattice";

/** A guide in its rest shape. Never changed in place. */
export interface Guide {
  readonly kind: GuideKind;
  /** Its points, in the order of the schema. */
  readonly rest: readonly Vector[];
  /** Which of them are joined by a line. */
  readonly links: readonly (readonly [number, number])[];
  /** How many points there are along each axis; of a lattice alone. */
  readonly counts: readonly [number, number, number];
}

/** Points of a curve. */
const CURVE_POINTS = 5;
/** Of the size, how far a lattice reaches beyond what it leads. */
const MARGIN = 0.01;

/** A guide around vertices: a lattice of three points along each axis, four along the longest, or a line along that. */
export function guideAround(kind: GuideKind, vertices: Uint32Array, rest: Float32Array): Guide {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (const vertex of vertices) {
    for (let axis = 0; axis < 3; axis++) {
      const x = rest[3 * vertex + axis] as number;
      low[axis] = Math.min(low[axis] as number, x);
      high[axis] = Math.max(high[axis] as number, x);
    }
  }
  const sizes = high.map((x, axis) => x - (low[axis] as number));
  const most = Math.max(...sizes) || 1;
  const longest = sizes.indexOf(Math.max(...sizes));
  const wide = kind === "lattice" ? sizes.map((size) => Math.max(size, most * 0.05) * (1 + 2 * MARGIN)) : sizes.map((size, axis) => (axis === longest ? size || most : 0));
  const from = wide.map((size, axis) => ((low[axis] as number) + (high[axis] as number) - size) / 2);
  const counts = [0, 1, 2].map((axis) => (kind === "lattice" ? (axis === longest ? 4 : 3) : axis === longest ? CURVE_POINTS : 1)) as [number, number, number];
  const points: Vector[] = [];
  const links: [number, number][] = [];
  const [nx, ny, nz] = counts;
  const along = (k: number, axis: number): number => (from[axis] as number) + ((counts[axis] as number) > 1 ? ((wide[axis] as number) * k) / ((counts[axis] as number) - 1) : 0);
  for (let k = 0; k < nz; k++) {
    for (let j = 0; j < ny; j++) {
      for (let i = 0; i < nx; i++) {
        const at = points.length;
        if (i > 0) links.push([at - 1, at]);
        if (j > 0) links.push([at - nx, at]);
        if (k > 0) links.push([at - nx * ny, at]);
        points.push([along(i, 0), along(j, 1), along(k, 2)]);
      }
    }
  }
  return { kind, rest: points, links, counts };
}

/** The guide as the schema has it; `toModel` takes a place there. */
export function guideMessage({ kind, rest, counts }: Guide, toModel: (place: Vector) => Vector): NonNullable<Handle["guide"]> {
  const points = flat(rest.map(toModel));
  if (kind === "curve") return { shape: { case: "curve", value: { points } } };
  const [first, last] = [rest[0] as Vector, rest[rest.length - 1] as Vector];
  const edge = (axis: number): number[] => [0, 1, 2].map((k) => (k === axis ? (last[k] as number) - (first[k] as number) : 0));
  return { shape: { case: "lattice", value: { origin: [...toModel(first)], edges: [...edge(0), ...edge(1), ...edge(2)], counts: [...counts] } } };
}

/** Places as one list of numbers. */
export function flat(places: readonly Vector[]): number[] {
  return places.flatMap((place) => [...place]);
}
