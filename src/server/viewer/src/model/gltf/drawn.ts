/**
 * How the vertices of an exported file lie over those of the session. A glTF comes back with its own vertices, one for
 * one. Formats that number corners apart come back divided at their seams; there a drawn vertex follows the render vertex
 * at its place.
 */

import { placesOf } from "../report.ts";
import type { Topology } from "pliant-client";
import { readNumbers } from "./accessors.ts";
import type { Canvas } from "./appearance.ts";
import { type GltfFile, member } from "./file.ts";
import type { SceneTree } from "./scene.ts";

/** A run of render vertices as the server lists it. */
export interface Run {
  readonly vertexCount: number;
  readonly indexCount: number;
}

/** The vertices and triangles to draw; nothing when the file's do not fit the session's. */
export function canvasOf(file: GltfFile, tree: SceneTree, topology: Topology, runs: readonly Run[]): Canvas | undefined {
  const own = runs.filter(({ indexCount }) => indexCount > 0);
  const { placements } = tree;
  const vertices = topology.positions.length / 3;
  const counts = own.map(({ indexCount }) => indexCount);
  const same =
    own.length === placements.length &&
    own.every(({ vertexCount }, k) => placements[k]?.vertices === vertexCount) &&
    own.reduce((sum, { vertexCount }) => sum + vertexCount, 0) === vertices &&
    counts.reduce((sum, count) => sum + count, 0) === topology.indices.length;
  if (same) return { vertices, indices: topology.indices, counts, source: undefined };
  return dividedCanvas(file, tree, topology);
}

function dividedCanvas(file: GltfFile, { placements }: SceneTree, topology: Topology): Canvas | undefined {
  const renderVertices = topology.positions.length / 3;
  const drawn = placements.reduce((sum, { vertices }) => sum + vertices, 0);
  const both = new Float32Array((renderVertices + drawn) * 3);
  both.set(topology.positions);
  const counts: number[] = [];
  const runs: Uint32Array[] = [];
  for (const { primitive, first, vertices } of placements) {
    const positions = readNumbers(file, member(primitive, "attributes")["POSITION"], 3);
    const corners = readNumbers(file, primitive["indices"], 1);
    if (positions?.length !== vertices * 3 || corners === undefined || corners.some((v) => v >= vertices)) return undefined;
    both.set(positions, (renderVertices + first) * 3);
    runs.push(Uint32Array.from(corners, (v) => v + first));
    counts.push(corners.length);
  }
  const { placeOf, places } = placesOf(both);
  const renderAt = new Int32Array(places).fill(-1);
  for (let v = renderVertices - 1; v >= 0; v--) renderAt[placeOf[v] as number] = v;
  const source = new Uint32Array(drawn);
  for (let v = 0; v < drawn; v++) {
    const found = renderAt[placeOf[renderVertices + v] as number] as number;
    if (found < 0) return undefined;
    source[v] = found;
  }
  const indices = new Uint32Array(counts.reduce((sum, count) => sum + count, 0));
  let at = 0;
  for (const run of runs) {
    indices.set(run, at);
    at += run.length;
  }
  return { vertices: drawn, indices, counts, source };
}
