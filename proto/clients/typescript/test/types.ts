/** What the types let through and what they refuse; `npm run check` reads this, nothing runs it. */

import { type AnimateOptions, type CreateOptions, type Edit, type Handle, type PlainRegion, type RegionLike, regionOf, schema, type SolveOptions } from "../src/index.js";

/** Every kind of region, as people write it. */
export const plain: readonly PlainRegion[] = [
  { vertices: [3, 1, 2] },
  { vertices: Uint32Array.of(3, 1, 2) },
  { halfSpace: { normal: [0, -1, 0], offset: -0.14 } },
  { sphere: { center: [0.76, 1.22, 0], radius: 0.36 } },
  { box: { min: [0, 0, 0], max: [1, 1, 1] } },
  { capsule: { from: [0, 0, 0], to: [0, 1, 0], radius: 0.2 } },
  { tube: { points: [[0, 0, 0], [0, 1, 0], [1, 1, 0]], radius: 0.2 } },
  { component: 0 },
  { primitive: 1 },
  { weights: [0, 0.5, 1] },
];

/** The schema's message as well. */
export const messages: readonly RegionLike[] = [
  regionOf([1, 2, 3]),
  { region: { case: "sphere", value: { center: [0, 0, 0], radius: 1 } } },
];

export const handle: Handle = { id: "head", region: { sphere: { center: [0, 1, 0], radius: 0.3 } }, stiffness: 2 };

/** What does not pass. */
export const wrong: readonly RegionLike[] = [
  // @ts-expect-error no such kind
  { ball: { center: [0, 0, 0], radius: 1 } },
  // @ts-expect-error a center has three numbers
  { sphere: { center: [0, 0], radius: 1 } },
  // @ts-expect-error the radius is missing
  { sphere: { center: [0, 0, 0] } },
  // @ts-expect-error two kinds at once
  { sphere: { center: [0, 0, 0], radius: 1 }, component: 0 },
  // @ts-expect-error nothing at all
  {},
];

/** Enums by name, or by number. */
export const options: readonly SolveOptions[] = [
  { output: { encoding: "DELTA" }, fit: "COARSE_FIRST", tolerance: 1e-4 },
  { output: { encoding: schema.Frame_Encoding.DELTA } },
  // @ts-expect-error no such encoding
  { output: { encoding: "delta" } },
  // @ts-expect-error the name of another enum
  { output: { encoding: "COARSE_FIRST" } },
  // @ts-expect-error a number is none
  { tolerance: "DELTA" },
];
export const soft: Handle = { id: "head", region: { component: 0 }, constrains: ["POSITION"], falloff: { radius: 1, kind: "SMOOTH" } };
export const built: CreateOptions = { volumeGraph: { mode: "OFF" }, components: "HOLD" };
export const played: AnimateOptions = { clip: "walk", playedAs: "SKIN", contact: "AVOID" };
export const finer: Edit = { on: "REST", operation: { case: "subdivide", value: { scheme: "LOOP" } } };
