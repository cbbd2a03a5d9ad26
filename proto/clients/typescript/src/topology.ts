/**
 * The triangles of a session's model, with places and normals, in the order in which frames carry its vertices.
 *
 * It is read from a file that the server rewrites: a PLY, or a GLB of models that came as PLY and would come back in their own form.
 */

import type { Vector } from "./rotation.js";

/** Triangles, and the vertices that they join. */
export interface Topology {
  /** x, y, z per render vertex, relative to the session's origin. */
  readonly positions: Float32Array<ArrayBuffer>;
  /** Normals, when the model has one for every vertex. */
  readonly normals: Float32Array<ArrayBuffer> | undefined;
  /** Three per triangle. */
  readonly indices: Uint32Array<ArrayBuffer>;
}

/** The format in which the server rewrites the triangles of such a model. */
export function topologyFormat(opened: string | undefined): "glb" | "ply" {
  return ["ply", "splat", "spz"].includes(opened ?? "") ? "glb" : "ply";
}

/** Reads such a file. */
export function readTopology(bytes: ArrayBuffer, origin: Vector): Topology {
  return new DataView(bytes).getUint32(0, true) === GLTF ? readGlb(bytes, origin) : readPly(bytes, origin);
}

/** A run of render vertices with triangles or, with an `indexCount` of 0, of points, lines or splats. */
interface Run {
  readonly firstVertex: number;
  readonly vertexCount: number;
  readonly indexCount: number;
}

/** A surface from a file that leaves out points, lines and the centres of splats, with vertices as the session counts them. */
export function amongAll(surface: Topology, positions: Float32Array<ArrayBuffer>, primitives: readonly Run[]): Topology {
  const drawn = primitives.filter((primitive) => primitive.indexCount > 0);
  const rows = drawn.flatMap((run) => Array.from({ length: run.vertexCount }, (_, k) => run.firstVertex + k));
  if (rows.length * 3 !== surface.positions.length) throw new Error("the server sent the triangles of another model");
  return { positions, normals: undefined, indices: surface.indices.map((vertex) => rows[vertex] ?? 0) };
}

const GLTF = 0x46546c67;
const SIZES: Record<string, number> = { double: 8, float: 4, uint: 4, int: 4, ushort: 2, short: 2, uchar: 1, char: 1 };

/** Reads the binary PLY that the server writes: scalar vertex properties, one index list per face. */
function readPly(bytes: ArrayBuffer, origin: Vector): Topology {
  const head = new TextDecoder("latin1").decode(bytes.slice(0, 4096));
  const end = head.indexOf("end_header\n");
  if (!head.startsWith("ply\n") || end < 0 || !head.includes("format binary_little_endian")) {
    throw new Error("the server sent a PLY file of another kind");
  }
  let vertices = 0;
  let faces = 0;
  let stride = 0;
  const offsets = new Map<string, { at: number; type: string }>();
  let inVertices = false;
  for (const line of head.slice(0, end).split("\n")) {
    const [word, first = "", second = ""] = line.split(" ");
    if (word === "element") {
      inVertices = first === "vertex";
      if (inVertices) vertices = Number(second);
      else if (first === "face") faces = Number(second);
    } else if (word === "property" && inVertices) {
      offsets.set(second, { at: stride, type: first });
      stride += SIZES[first] ?? 0;
    }
  }
  const start = end + "end_header\n".length;
  const view = new DataView(bytes, start);
  const column = (names: readonly string[], base: Vector): Float32Array<ArrayBuffer> | undefined => {
    const places = names.map((name) => offsets.get(name));
    if (places.some((place) => place === undefined)) return undefined;
    const out = new Float32Array(vertices * 3);
    places.forEach((place, c) => {
      const { at, type } = place as { at: number; type: string };
      for (let v = 0, from = at; v < vertices; v++, from += stride) {
        const value = type === "double" ? view.getFloat64(from, true) : view.getFloat32(from, true);
        out[v * 3 + c] = value - (base[c] as number);
      }
    });
    return out;
  };
  const positions = column(["x", "y", "z"], origin);
  if (positions === undefined) throw new Error("the server sent a PLY file without positions");
  const indices = new Uint32Array(faces * 3);
  let at = vertices * stride;
  for (let f = 0; f < faces; f++) {
    if (view.getUint8(at) !== 3) throw new Error("the server sent a face that is not a triangle");
    indices[f * 3] = view.getUint32(at + 1, true);
    indices[f * 3 + 1] = view.getUint32(at + 5, true);
    indices[f * 3 + 2] = view.getUint32(at + 9, true);
    at += 13;
  }
  return { positions, normals: column(["nx", "ny", "nz"], [0, 0, 0]), indices };
}

interface Accessor {
  bufferView: number;
  byteOffset?: number;
  componentType: number;
  count: number;
}
interface Document {
  accessors: Accessor[];
  bufferViews: { byteOffset?: number }[];
  nodes?: { mesh?: number; translation?: number[] }[];
  meshes: { primitives: { attributes: Record<string, number>; indices?: number }[] }[];
}

/** Reads the GLB that the server writes afresh: tightly packed floats and indices in one buffer. */
function readGlb(bytes: ArrayBuffer, origin: Vector): Topology {
  const view = new DataView(bytes);
  const jsonLength = view.getUint32(12, true);
  const document = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 20, jsonLength))) as Document;
  const binary = 20 + jsonLength + 8;
  const place = (accessor: Accessor): number =>
    binary + (document.bufferViews[accessor.bufferView]?.byteOffset ?? 0) + (accessor.byteOffset ?? 0);
  const at = (index: number | undefined): Accessor => {
    const accessor = index === undefined ? undefined : document.accessors[index];
    if (accessor === undefined) throw new Error("the server sent a GLB file without triangles");
    return accessor;
  };
  // Far from the origin the nodes of meshes have a translation.
  const placed = document.meshes.flatMap((mesh, k) => {
    const { translation = [0, 0, 0] } = document.nodes?.find((node) => node.mesh === k) ?? {};
    return mesh.primitives.map((primitive) => ({ primitive, away: translation.map((value, c) => value - (origin[c] ?? 0)) }));
  });
  const positions: Float32Array[] = [];
  const normals: Float32Array[] = [];
  const indices: Uint32Array[] = [];
  let first = 0;
  for (const { primitive, away } of placed) {
    const position = at(primitive.attributes["POSITION"]);
    const own = new Float32Array(bytes.slice(place(position), place(position) + position.count * 12));
    positions.push(own.map((value, k) => value + (away[k % 3] ?? 0)));
    if (primitive.attributes["NORMAL"] !== undefined) {
      const normal = at(primitive.attributes["NORMAL"]);
      normals.push(new Float32Array(bytes.slice(place(normal), place(normal) + normal.count * 12)));
    }
    const accessor = at(primitive.indices);
    const from = place(accessor);
    const wide = accessor.componentType === 5125;
    const narrow = accessor.componentType === 5121;
    indices.push(
      Uint32Array.from({ length: accessor.count }, (_, k) => {
        if (wide) return first + view.getUint32(from + k * 4, true);
        return first + (narrow ? view.getUint8(from + k) : view.getUint16(from + k * 2, true));
      }),
    );
    first += position.count;
  }
  const whole = normals.length === placed.length ? joined(normals) : undefined;
  return { positions: joined(positions), normals: whole, indices: joinedIndices(indices) };
}

function joined(runs: Float32Array[]): Float32Array<ArrayBuffer> {
  const out = new Float32Array(runs.reduce((sum, run) => sum + run.length, 0));
  let at = 0;
  for (const run of runs) {
    out.set(run, at);
    at += run.length;
  }
  return out;
}

function joinedIndices(runs: Uint32Array[]): Uint32Array<ArrayBuffer> {
  const out = new Uint32Array(runs.reduce((sum, run) => sum + run.length, 0));
  let at = 0;
  for (const run of runs) {
    out.set(run, at);
    at += run.length;
  }
  return out;
}
