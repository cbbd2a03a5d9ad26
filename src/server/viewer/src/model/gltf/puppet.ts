/**
 * The vertices of a file while a clip plays: nodes move, morph targets are blended in, skins follow their joints. Answers
 * positions in the order of render vertices, so that what draws a pose also draws a clip.
 */

import type { Vector } from "pliant-client";
import { readNumbers } from "./accessors.ts";
import { type Channel, channelsOf } from "./clips.ts";
import { type GltfFile, type Item, itemAt, items, member } from "./file.ts";
import { IDENTITY, compose, multiply } from "./matrices.ts";
import type { Placement, SceneTree } from "./scene.ts";

/** Numbers that morph targets of one file may have in all. */
const MOST_MORPH_NUMBERS = 1 << 27;

/** What a primitive's vertices follow. */
interface Bound {
  readonly node: number;
  readonly first: number;
  readonly vertices: number;
  readonly base: Float32Array;
  readonly targets: readonly (Float32Array | undefined)[];
  readonly skin: Skin | undefined;
  /** Four for each vertex and set. */
  readonly joints: readonly Float32Array[];
  readonly weights: readonly Float32Array[];
}

interface Skin {
  readonly joints: readonly number[];
  readonly inverse: Float32Array | undefined;
  /** The matrices of the joints as they are now. */
  readonly palette: Float64Array;
}

/** A node's values while a clip plays. */
interface Moving {
  translation: number[];
  rotation: number[];
  scale: number[];
  matrix: readonly number[] | undefined;
  weights: number[];
}

export class Puppet {
  private readonly bound: readonly Bound[];
  private readonly skins = new Map<number, Skin>();
  private readonly worlds: Float64Array;
  private readonly moving: Moving[];
  private channels: { clip: number; list: readonly Channel[] } | undefined;
  private readonly local = new Float64Array(16);
  private readonly value: number[] = [];

  constructor(
    private readonly file: GltfFile,
    private readonly tree: SceneTree,
    /** What the shape is written relative to. */
    private readonly origin: Vector,
  ) {
    this.worlds = new Float64Array(tree.nodes.length * 16);
    let left = MOST_MORPH_NUMBERS;
    this.bound = tree.placements.flatMap((placement) => {
      const bound = this.bind(placement, left);
      left -= bound === undefined ? 0 : bound.targets.length * bound.base.length;
      return bound === undefined ? [] : [bound];
    });
    this.moving = tree.nodes.map(() => ({ translation: [], rotation: [], scale: [], matrix: undefined, weights: [] }));
    this.rest();
  }

  /** Writes the shape at a time of a clip into `out`, x, y, z per render vertex. What cannot be computed stays as it was. */
  pose(clip: number, seconds: number, out: Float32Array): void {
    if (this.channels?.clip !== clip) {
      this.channels = { clip, list: channelsOf(this.file, clip, (node) => this.targetsOf(node)) };
    }
    this.rest();
    for (const channel of this.channels.list) {
      const node = this.moving[channel.node];
      if (node === undefined) continue;
      this.value.length = 0;
      channel.at(seconds, this.value);
      if (channel.path !== "weights") node.matrix = undefined;
      node[channel.path] = this.value.slice();
    }
    this.place();
    for (const bound of this.bound) this.write(bound, out);
  }

  private bind({ node, primitive, first, vertices }: Placement, left: number): Bound | undefined {
    const { file } = this;
    const attributes = member(primitive, "attributes");
    const base = readNumbers(file, attributes["POSITION"], 3);
    if (base === undefined || base.length !== vertices * 3) return undefined;
    const all = items(primitive["targets"]);
    const fitting = all.length * base.length <= left ? all : [];
    const targets = fitting.map((target) => {
      const moved = target["POSITION"] === undefined ? undefined : readNumbers(file, target["POSITION"], 3);
      return moved !== undefined && moved.length === base.length ? moved : undefined;
    });
    const skin = this.skinOf(this.tree.nodes[node]);
    const joints: Float32Array[] = [];
    const weights: Float32Array[] = [];
    for (let set = 0; skin !== undefined && set < 16; set++) {
      const index = readNumbers(file, attributes[`JOINTS_${set}`], 4);
      const share = readNumbers(file, attributes[`WEIGHTS_${set}`], 4);
      if (index?.length !== vertices * 4 || share?.length !== vertices * 4) break;
      joints.push(index);
      weights.push(share);
    }
    return { node, first, vertices, base, targets, skin, joints, weights };
  }

  private skinOf(node: Item | undefined): Skin | undefined {
    const index = node?.["skin"];
    const skin = itemAt(this.file, "skins", index);
    if (skin === undefined || typeof index !== "number") return undefined;
    let known = this.skins.get(index);
    if (known === undefined) {
      const joints = (Array.isArray(skin["joints"]) ? skin["joints"] : []).map(Number).map((k) => (this.tree.nodes[k] === undefined ? -1 : k));
      const inverse = readNumbers(this.file, skin["inverseBindMatrices"], 16);
      const fits = inverse !== undefined && inverse.length >= joints.length * 16;
      known = { joints, inverse: fits ? inverse : undefined, palette: new Float64Array(joints.length * 16) };
      this.skins.set(index, known);
    }
    return known;
  }

  /** How many morph targets the mesh of a node has. */
  private targetsOf(node: number): number {
    const mesh = itemAt(this.file, "meshes", this.tree.nodes[node]?.["mesh"]);
    return Math.max(0, ...items(mesh?.["primitives"]).map((primitive) => items(primitive["targets"]).length));
  }

  private rest(): void {
    for (const [k, frame] of this.tree.frames.entries()) {
      const node = this.moving[k] as Moving;
      Object.assign(node, frame);
      const own = this.tree.nodes[k]?.["weights"] ?? itemAt(this.file, "meshes", this.tree.nodes[k]?.["mesh"])?.["weights"];
      node.weights = Array.isArray(own) ? own.map(Number) : [];
    }
  }

  /** World matrices of all nodes, and the palettes of the skins. */
  private place(): void {
    const { worlds, local, tree } = this;
    for (const k of tree.order) {
      const node = this.moving[k] as Moving;
      const parent = tree.parents[k] as number;
      if (node.matrix === undefined) compose(local, 0, node.translation, node.rotation, node.scale);
      else local.set(node.matrix);
      if (parent < 0) worlds.set(local, k * 16);
      else multiply(worlds, k * 16, worlds, parent * 16, local, 0);
    }
    for (const { joints, inverse, palette } of this.skins.values()) {
      for (const [k, joint] of joints.entries()) {
        if (joint < 0) palette.set(IDENTITY, k * 16);
        else if (inverse === undefined) palette.set(worlds.subarray(joint * 16, joint * 16 + 16), k * 16);
        else multiply(palette, k * 16, worlds, joint * 16, inverse, k * 16);
      }
    }
  }

  private write(bound: Bound, out: Float32Array): void {
    const { first, vertices, skin, node } = bound;
    if ((first + vertices) * 3 > out.length) return;
    const shape = this.morphed(bound);
    const skinned = skin !== undefined && bound.joints.length > 0;
    const blend = new Float64Array(16);
    if (!skinned) blend.set(skin === undefined ? this.worlds.subarray(node * 16, node * 16 + 16) : IDENTITY);
    for (let v = 0; v < vertices; v++) {
      if (skinned && !mixed(bound, skin.palette, v, blend)) continue;
      const [x, y, z] = [shape[v * 3] as number, shape[v * 3 + 1] as number, shape[v * 3 + 2] as number];
      const at = (first + v) * 3;
      for (let row = 0; row < 3; row++) {
        const sum = (blend[row] as number) * x + (blend[4 + row] as number) * y + (blend[8 + row] as number) * z + (blend[12 + row] as number);
        if (Number.isFinite(sum)) out[at + row] = sum - (this.origin[row] as number);
      }
    }
  }

  /** The primitive's own shape with its morph targets blended in. */
  private morphed({ base, targets, node }: Bound): Float32Array {
    const weights = this.moving[node]?.weights ?? [];
    if (!targets.some((target, k) => target !== undefined && isUseful(weights[k]))) return base;
    const shape = base.slice();
    for (const [k, target] of targets.entries()) {
      const weight = weights[k];
      if (target === undefined || !isUseful(weight)) continue;
      for (let n = 0; n < shape.length; n++) shape[n] = (shape[n] as number) + weight * (target[n] as number);
    }
    return shape;
  }
}

function isUseful(weight: number | undefined): weight is number {
  return weight !== undefined && weight !== 0 && Number.isFinite(weight);
}

/** The mean of the joints' matrices by a vertex's weights; `false` when it has none. */
function mixed({ joints, weights }: Bound, palette: Float64Array, vertex: number, out: Float64Array): boolean {
  out.fill(0);
  let sum = 0;
  for (const [set, index] of joints.entries()) {
    const share = weights[set] as Float32Array;
    for (let k = vertex * 4; k < vertex * 4 + 4; k++) {
      const weight = share[k] as number;
      const from = (index[k] as number) * 16;
      if (!(weight > 0) || from + 16 > palette.length) continue;
      sum += weight;
      for (let n = 0; n < 16; n++) out[n] = (out[n] as number) + weight * (palette[from + n] as number);
    }
  }
  if (!(sum > 0)) return false;
  if (Math.abs(sum - 1) > 1e-6) for (let n = 0; n < 16; n++) out[n] = (out[n] as number) / sum;
  return true;
}
