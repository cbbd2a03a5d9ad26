/** Numbers out of accessors: any component type, normalised or not, interleaved, sparse. */

import { type GltfFile, type Item, isItem, itemAt, member, viewBytes, whole } from "./file.ts";

interface Component {
  readonly size: number;
  readonly read: (view: DataView, at: number) => number;
  /** What a normalised number is divided by; 0 for floats. */
  readonly full: number;
}

const COMPONENTS: Record<number, Component> = {
  5120: { size: 1, read: (view, at) => view.getInt8(at), full: 127 },
  5121: { size: 1, read: (view, at) => view.getUint8(at), full: 255 },
  5122: { size: 2, read: (view, at) => view.getInt16(at, true), full: 32767 },
  5123: { size: 2, read: (view, at) => view.getUint16(at, true), full: 65535 },
  5125: { size: 4, read: (view, at) => view.getUint32(at, true), full: 0 },
  5126: { size: 4, read: (view, at) => view.getFloat32(at, true), full: 0 },
};
const LANES: Record<string, number> = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4, MAT4: 16 };
/** Elements that an accessor without bytes may have: its count proves nothing. */
const MOST_UNBACKED = 1 << 22;

/** How many elements an accessor has. */
export function countOf(file: GltfFile, index: unknown): number | undefined {
  return whole(itemAt(file, "accessors", index)?.["count"]);
}

/** How many numbers an element of an accessor has. */
export function lanesOf(file: GltfFile, index: unknown): number | undefined {
  return LANES[String(itemAt(file, "accessors", index)?.["type"])];
}

/** The numbers of an accessor of this shape; `undefined` when there is none or its bytes are not there. */
export function readNumbers(file: GltfFile, index: unknown, lanes: number): Float32Array<ArrayBuffer> | undefined {
  const accessor = itemAt(file, "accessors", index);
  const count = whole(accessor?.["count"]);
  const component = COMPONENTS[Number(accessor?.["componentType"])];
  if (accessor === undefined || count === undefined || component === undefined || lanesOf(file, index) !== lanes) return undefined;
  const scale = accessor["normalized"] === true && component.full > 0 ? 1 / component.full : 1;
  let out: Float32Array<ArrayBuffer>;
  if (accessor["bufferView"] === undefined) {
    if (count > MOST_UNBACKED) return undefined;
    out = new Float32Array(count * lanes);
  } else {
    const stride = whole(itemAt(file, "bufferViews", accessor["bufferView"])?.["byteStride"]) ?? 0;
    const place = { view: accessor["bufferView"], from: accessor["byteOffset"], stride };
    const read = readRun(file, place, component, lanes, count, scale);
    if (read === undefined) return undefined;
    out = read;
  }
  return isItem(accessor["sparse"]) ? withOverrides(file, accessor["sparse"], component, lanes, scale, out) : out;
}

interface Place {
  readonly view: unknown;
  readonly from: unknown;
  /** Bytes from element to element; 0 = packed. */
  readonly stride: number;
}

function readRun(file: GltfFile, place: Place, component: Component, lanes: number, count: number, scale: number): Float32Array<ArrayBuffer> | undefined {
  const bytes = viewBytes(file, place.view);
  const from = whole(place.from ?? 0);
  const packed = component.size * lanes;
  const stride = place.stride === 0 ? packed : place.stride;
  if (bytes === undefined || from === undefined || stride < packed) return undefined;
  if (count > 0 && from + (count - 1) * stride + packed > bytes.length) return undefined;
  const out = new Float32Array(count * lanes);
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
  for (let k = 0, at = from, n = 0; k < count; k++, at += stride) {
    for (let lane = 0; lane < lanes; lane++) {
      // The lowest of a signed type stands for -1 as the one above it does.
      out[n++] = scale === 1 ? component.read(view, at + lane * component.size) : Math.max(-1, component.read(view, at + lane * component.size) * scale);
    }
  }
  return out;
}

function withOverrides(file: GltfFile, sparse: Item, component: Component, lanes: number, scale: number, out: Float32Array<ArrayBuffer>): Float32Array<ArrayBuffer> | undefined {
  const count = whole(sparse["count"]) ?? 0;
  const [indices, values] = [member(sparse, "indices"), member(sparse, "values")];
  const kind = COMPONENTS[Number(indices["componentType"])];
  if (kind === undefined) return undefined;
  const where = readRun(file, { view: indices["bufferView"], from: indices["byteOffset"], stride: 0 }, kind, 1, count, 1);
  const what = readRun(file, { view: values["bufferView"], from: values["byteOffset"], stride: 0 }, component, lanes, count, scale);
  if (where === undefined || what === undefined) return undefined;
  for (let k = 0; k < count; k++) {
    const at = (where[k] as number) * lanes;
    if (at + lanes <= out.length) out.set(what.subarray(k * lanes, k * lanes + lanes), at);
  }
  return out;
}
