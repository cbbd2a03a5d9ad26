/** Which primitives a file draws, in the order in which the server numbers their vertices, and the tree that places them. */

import { type GltfFile, type Item, itemAt, items, member, numbers, text, whole } from "./file.ts";
import { countOf } from "./accessors.ts";
import { IDENTITY } from "./matrices.ts";

/** One primitive under one node. */
export interface Placement {
  readonly node: number;
  readonly mesh: Item;
  readonly primitive: Item;
  /** Its first render vertex, and how many it has. */
  readonly first: number;
  readonly vertices: number;
}

/** How a node lies in its parent. */
export interface NodeFrame {
  readonly translation: readonly number[];
  readonly rotation: readonly number[];
  readonly scale: readonly number[];
  /** In place of the three. */
  readonly matrix: readonly number[] | undefined;
}

export interface SceneTree {
  readonly nodes: readonly Item[];
  readonly frames: readonly NodeFrame[];
  /** The parent of each node; -1 for roots. */
  readonly parents: Int32Array;
  /** All nodes, parents before children. */
  readonly order: Int32Array;
  readonly placements: readonly Placement[];
}

/** Walks the nodes as the server does: depth first, in the document's order. */
export function treeOf(file: GltfFile): SceneTree {
  const { document } = file;
  const nodes = items(document["nodes"]);
  const parents = new Int32Array(nodes.length).fill(-1);
  const childrenOf = (node: Item | undefined): number[] =>
    (Array.isArray(node?.["children"]) ? (node["children"] as unknown[]) : []).filter((child): child is number => nodes[Number(child)] !== undefined);
  for (const [index, node] of nodes.entries()) for (const child of childrenOf(node)) parents[child] = index;
  const noParent = nodes.map((_, k) => k).filter((k) => parents[k] === -1);

  const order: number[] = [];
  walk(noParent, nodes.length, (k) => childrenOf(nodes[k]), (k) => order.push(k));

  const scenes = items(document["scenes"]);
  const named = scenes[whole(document["scene"]) ?? -1];
  const rootsOf = (scene: Item): number[] => (Array.isArray(scene["nodes"]) ? scene["nodes"].map(Number) : []).filter((k) => nodes[k] !== undefined);
  const roots = named !== undefined ? rootsOf(named) : scenes.length > 0 ? scenes.flatMap(rootsOf) : noParent;
  const placements: Placement[] = [];
  let first = 0;
  walk(roots, nodes.length, (k) => childrenOf(nodes[k]), (node) => {
    const mesh = itemAt(file, "meshes", nodes[node]?.["mesh"]);
    for (const primitive of items(mesh?.["primitives"])) {
      const vertices = drawnVertices(file, primitive);
      if (mesh === undefined || vertices === 0) continue;
      placements.push({ node, mesh, primitive, first, vertices });
      first += vertices;
    }
  });
  return { nodes, frames: nodes.map(frameOf), parents, order: Int32Array.from(order), placements };
}

/** Visits every node below `roots` once; a chain of nodes may be as long as the file likes. */
function walk(roots: readonly number[], count: number, children: (node: number) => number[], visit: (node: number) => void): void {
  const seen = new Uint8Array(count);
  const open = roots.toReversed();
  for (let node = open.pop(); node !== undefined; node = open.pop()) {
    if (seen[node] === 1) continue;
    seen[node] = 1;
    visit(node);
    for (const child of children(node).reverse()) open.push(child);
  }
}

/** The vertices of a primitive; 0 when it has no triangles, which the server passes over. */
function drawnVertices(file: GltfFile, primitive: Item): number {
  const mode = whole(primitive["mode"] ?? 4) ?? 0;
  const position = member(primitive, "attributes")["POSITION"];
  const vertices = position === undefined ? 0 : (countOf(file, position) ?? 0);
  const corners = primitive["indices"] === undefined ? vertices : (countOf(file, primitive["indices"]) ?? 0);
  return mode < 4 || corners < 3 ? 0 : vertices;
}

function frameOf(node: Item): NodeFrame {
  return {
    translation: numbers(node["translation"], 3) ?? [0, 0, 0],
    rotation: numbers(node["rotation"], 4) ?? [0, 0, 0, 1],
    scale: numbers(node["scale"], 3) ?? [1, 1, 1],
    matrix: node["matrix"] === undefined ? undefined : (numbers(node["matrix"], 16) ?? IDENTITY),
  };
}

/** What people call a node. */
export function nameOf(node: Item | undefined, fallback: string): string {
  return text(node?.["name"]) ?? fallback;
}
