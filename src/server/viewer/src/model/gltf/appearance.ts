/** What a model's surface looks like: for every drawn vertex its texture coordinates and colour, for every run of triangles its look. */

import { readNumbers, lanesOf } from "./accessors.ts";
import { type GltfFile, type Item, member } from "./file.ts";
import { type Look, lookOf } from "./looks.ts";
import type { SceneTree } from "./scene.ts";

/** A run of indices that one look covers. */
export interface LookRun {
  readonly first: number;
  readonly count: number;
  readonly look: number;
}

export interface Appearance {
  readonly looks: readonly Look[];
  readonly runs: readonly LookRun[];
  /** Three per drawn triangle. */
  readonly indices: Uint32Array<ArrayBuffer>;
  /** For each drawn vertex its render vertex; nothing when they are the same. */
  readonly source: Uint32Array<ArrayBuffer> | undefined;
  /** Two for each drawn vertex. */
  readonly uv: Float32Array<ArrayBuffer> | undefined;
  /** Linear red, green, blue and opacity for each drawn vertex. */
  readonly colours: Float32Array<ArrayBuffer> | undefined;
}

/** The vertices and triangles that an appearance is put on. */
export interface Canvas {
  readonly vertices: number;
  readonly indices: Uint32Array<ArrayBuffer>;
  /** Indices of each placed primitive, in order. */
  readonly counts: readonly number[];
  readonly source: Uint32Array<ArrayBuffer> | undefined;
}

/** Reads what the file says of looks; nothing when it says no more than bare geometry. */
export function appearanceOf(file: GltfFile, tree: SceneTree, canvas: Canvas): Appearance | undefined {
  const numberOf = new Map<unknown, number>();
  const looks: Look[] = [];
  const runs: LookRun[] = [];
  let uv: Float32Array<ArrayBuffer> | undefined;
  let colours: Float32Array<ArrayBuffer> | undefined;
  let at = 0;
  for (const [k, { primitive, first, vertices }] of tree.placements.entries()) {
    const count = canvas.counts[k] ?? 0;
    let number = numberOf.get(primitive["material"]);
    if (number === undefined) {
      number = looks.length;
      numberOf.set(primitive["material"], number);
      looks.push(lookOf(file, primitive["material"]));
    }
    runs.push({ first: at, count, look: number });
    at += count;
    const { picture } = looks[number] as Look;
    const attributes = member(primitive, "attributes");
    const own = picture && readNumbers(file, attributes[`TEXCOORD_${picture.set}`], 2);
    if (picture !== undefined && own !== undefined && own.length === vertices * 2) {
      uv ??= new Float32Array(canvas.vertices * 2);
      place(own, picture.transform, uv, first * 2);
    }
    const painted = coloursOf(file, attributes, vertices);
    if (painted !== undefined) {
      colours ??= new Float32Array(canvas.vertices * 4).fill(1);
      colours.set(painted, first * 4);
    }
  }
  if (colours === undefined && looks.every(isBare)) return undefined;
  return { looks, runs, indices: canvas.indices, source: canvas.source, uv, colours };
}

/** Whether a look is that of no material at all. */
function isBare({ factor, picture, alpha }: Look): boolean {
  return picture === undefined && alpha === "OPAQUE" && factor.every((x) => x === 1);
}

function place(own: Float32Array, [a = 1, b = 0, c = 0, d = 0, e = 1, f = 0]: readonly number[], out: Float32Array, from: number): void {
  for (let k = 0; k < own.length; k += 2) {
    const [u, v] = [own[k] as number, own[k + 1] as number];
    const [x, y] = [a * u + b * v + c, d * u + e * v + f];
    out[from + k] = Number.isFinite(x) ? x : 0;
    out[from + k + 1] = Number.isFinite(y) ? y : 0;
  }
}

/** COLOR_0 with an opacity for each; three numbers mean opaque. */
function coloursOf(file: GltfFile, attributes: Item, vertices: number): Float32Array | undefined {
  const lanes = lanesOf(file, attributes["COLOR_0"]);
  if (lanes !== 3 && lanes !== 4) return undefined;
  const own = readNumbers(file, attributes["COLOR_0"], lanes);
  if (own === undefined || own.length !== vertices * lanes) return undefined;
  const out = new Float32Array(vertices * 4).fill(1);
  for (let v = 0; v < vertices; v++) {
    for (let lane = 0; lane < lanes; lane++) {
      const x = own[v * lanes + lane] as number;
      out[v * 4 + lane] = x >= 0 ? Math.min(1, x) : 0;
    }
  }
  return out;
}
