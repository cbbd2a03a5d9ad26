/** Regions: which vertices a handle or an edit takes. */

import { create, isMessage } from "@bufbuild/protobuf";
import type { MessageInitShape } from "@bufbuild/protobuf";
import { PliantError } from "./errors.js";
import type { Region } from "./gen/pliant/v1/pliant_pb.js";
import { RegionSchema } from "./gen/pliant/v1/pliant_pb.js";
import { isNumbers, written as shown } from "./poses.js";

/** x, y, z in model units. */
export type Point = readonly [x: number, y: number, z: number];

/** Ways to name vertices, in the rest pose and in model space. */
export interface RegionKinds {
  /** Render vertices by number, in any order. */
  vertices: ArrayLike<number>;
  /** Points x with normal · x ≥ offset. */
  halfSpace: { normal: Point; offset: number };
  /** Points within a ball. */
  sphere: { center: Point; radius: number };
  /** Points within a box along the axes. */
  box: { min: Point; max: Point };
  /** Points no further than the radius from the line between two points. */
  capsule: { from: Point; to: Point; radius: number };
  /** Points no further than the radius from a polyline. */
  tube: { points: readonly Point[]; radius: number };
  /** A connected part, by number. */
  component: number;
  /** An entry of `session.facts.primitives`, by number. */
  primitive: number;
  /** A number from 0 to 1 for every render vertex; those above 0 are in the region. */
  weights: ArrayLike<number>;
  /** Points of the surface, for targets: `faces`, triangles by number, or `corners`, three render vertices each, and three weights each. */
  anchors: { faces?: ArrayLike<number>; corners?: ArrayLike<number>; weights: ArrayLike<number> };
}

/** One entry of `T`, and none of the others. */
type OneOf<T> = { [K in keyof T]: { readonly [P in K]: T[P] } & { readonly [P in Exclude<keyof T, K>]?: never } }[keyof T];

/** A region as a plain object with one key, such as `{ sphere: { center: [0, 1, 0], radius: 0.3 } }`. */
export type PlainRegion = OneOf<RegionKinds>;

/** A region as the schema's message has it. */
type RegionMessage = { [K in keyof RegionKinds]?: never } & { region: MessageInitShape<typeof RegionSchema>["region"] };

/** A region: a plain object, or the schema's message. */
export type RegionLike = PlainRegion | Region | RegionMessage;

/** Runs shorter than this are cheaper as single indices. */
const SHORTEST_RUN = 4;

/** How each kind of region is written in the schema. */
const WRITTEN: { readonly [K in keyof RegionKinds]: (value: RegionKinds[K]) => Region } = {
  vertices: (value) => regionOf(rising(value)),
  halfSpace: ({ normal, offset }) => written({ case: "halfSpace", value: { normal: [...normal], offset } }),
  sphere: ({ center, radius }) => written({ case: "sphere", value: { center: [...center], radius } }),
  box: ({ min, max }) => written({ case: "box", value: { min: [...min], max: [...max] } }),
  capsule: ({ from, to, radius }) => written({ case: "capsule", value: { from: [...from], to: [...to], radius } }),
  tube: ({ points, radius }) => written({ case: "tube", value: { points: points.flat(), radius } }),
  component: (index) => written({ case: "component", value: { index } }),
  primitive: (index) => written({ case: "primitive", value: { index } }),
  weights: (values) => written({ case: "weights", value: { values: Array.from(values) } }),
  anchors: ({ faces = [], corners = [], weights }) => {
    const [f, c, w] = [faces, corners, weights].map((list) => Array.from(list)) as [number[], number[], number[]];
    return written({ case: "anchors", value: { faces: f, corners: c, weights: w } });
  },
};

const POINT = "three numbers";
const NUMBER = "a number";
const POINTS = "a list of points of three numbers";

/** What each key of a kind takes, where a kind is an object. */
const KEYS: { readonly [K in keyof RegionKinds]?: Readonly<Record<string, string>> } = {
  halfSpace: { normal: POINT, offset: NUMBER },
  sphere: { center: POINT, radius: NUMBER },
  box: { min: POINT, max: POINT },
  capsule: { from: POINT, to: POINT, radius: NUMBER },
  tube: { points: POINTS, radius: NUMBER },
};

/** Refuses keys that a kind does not have or lacks, and what is none of what they take. */
function checkKeys(kind: keyof RegionKinds, value: unknown): void {
  const keys = KEYS[kind];
  if (keys === undefined) return;
  const allowed = Object.entries(keys).map(([key, takes]) => `${key} (${takes})`).join(" and ");
  if (typeof value !== "object" || value === null) throw new Error(`is ${shown(value)}, an object with ${allowed} is allowed`);
  const stray = Object.keys(value).find((key) => !Object.hasOwn(keys, key));
  if (stray !== undefined) throw new Error(`${stray} is not a key of it; allowed are ${allowed}`);
  for (const [key, takes] of Object.entries(keys)) {
    const given = (value as Record<string, unknown>)[key];
    // Vectors of other libraries are lists as well; points in a row may be flat.
    const isPoint = (x: unknown): boolean => isNumbers(typeof x === "object" && x !== null && Symbol.iterator in x ? [...(x as Iterable<unknown>)] : x, [3]);
    const arePoints = (x: unknown): boolean => Array.isArray(x) && (x.every(isPoint) || isNumbers(x, [x.length]));
    const fits = takes === NUMBER ? typeof given === "number" : takes === POINT ? isPoint(given) : arePoints(given);
    if (given === undefined) throw new Error(`${key} is missing; it takes ${allowed}`);
    if (!fits) throw new Error(`${key} is ${shown(given)}, it takes ${takes}`);
  }
}

/** The schema's message of a region. Fails when it is none: not exactly one of the kinds. */
export function regionFrom(region: RegionLike): Region {
  if (isMessage(region, RegionSchema)) return region;
  const keys = Object.keys(region).filter((key) => region[key as keyof typeof region] !== undefined);
  const [kind] = keys;
  if (keys.length === 1 && kind === "region") return create(RegionSchema, region as MessageInitShape<typeof RegionSchema>);
  if (keys.length !== 1 || kind === undefined || !Object.hasOwn(WRITTEN, kind)) {
    const seen = keys.join(" and ") || "nothing";
    const allowed = Object.keys(WRITTEN).join(", ");
    throw new PliantError("INVALID_ARGUMENT", `region: ${seen} is given, exactly one of ${allowed} is allowed`);
  }
  try {
    checkKeys(kind as keyof RegionKinds, region[kind as keyof typeof region]);
    return (WRITTEN[kind as keyof RegionKinds] as (value: unknown) => Region)(region[kind as keyof typeof region]);
  } catch (error) {
    const why = error instanceof Error ? error.message : String(error);
    throw new PliantError("INVALID_ARGUMENT", `region: ${kind}: ${why}`);
  }
}

/** The region that holds exactly these render vertices. `indices` must be ascending and without repeats. */
export function regionOf(indices: ArrayLike<number>): Region {
  const single: number[] = [];
  const ranges: { first: number; count: number }[] = [];
  for (let k = 0; k < indices.length; ) {
    const first = indices[k] as number;
    let count = 1;
    while (k + count < indices.length && indices[k + count] === first + count) {
      count += 1;
    }
    if (count >= SHORTEST_RUN) {
      ranges.push({ first, count });
    } else {
      for (let j = 0; j < count; j++) {
        single.push(first + j);
      }
    }
    k += count;
  }
  return written({ case: "vertices", value: { indices: single, ranges } });
}

function written(region: MessageInitShape<typeof RegionSchema>["region"]): Region {
  return create(RegionSchema, { region } as MessageInitShape<typeof RegionSchema>);
}

/** Numbers in ascending order, each once. */
function rising(numbers: ArrayLike<number>): number[] {
  return [...new Set(Array.from(numbers))].sort((a, b) => a - b);
}
