/**
 * A glTF file, opened: its document, and the bytes behind its buffer views.
 *
 * The server checks what geometry needs. Materials, images, skins and animations come as they were uploaded, so that
 * everything here may be missing, of another type, or out of range; it then counts as absent, and nothing fails.
 */

import { MeshoptDecoder } from "meshopt-decoder";

/** An object of the document, of which nothing is known. */
export type Item = { readonly [key: string]: unknown };

/** An opened file. */
export interface GltfFile {
  readonly document: Item;
  /** The bytes of each buffer that has any. */
  readonly buffers: readonly (Uint8Array<ArrayBuffer> | undefined)[];
  /** Files that came along, by the name that the document calls them. */
  readonly companions: ReadonlyMap<string, Blob>;
  /** Decompressed views, and how many more bytes may be decompressed. */
  readonly unpacked: { readonly views: Map<number, Uint8Array<ArrayBuffer>>; left: number };
}

const MAGIC = 0x46546c67;
const JSON_CHUNK = 0x4e4f534a;
const BIN_CHUNK = 0x004e4942;
/** Bytes that views may have after decompression, all together. */
const MOST_UNPACKED = 1 << 29;

/** Opens a GLB or a glTF document. */
export async function openGltf(blob: Blob, companions: ReadonlyMap<string, Blob>): Promise<GltfFile> {
  const bytes = new Uint8Array(await blob.arrayBuffer());
  const { json, bin } = chunksOf(bytes);
  const parsed: unknown = JSON.parse(new TextDecoder().decode(json));
  if (!isItem(parsed)) throw new Error("the server sent a glTF document that is not an object");
  const buffers: (Uint8Array<ArrayBuffer> | undefined)[] = [];
  for (const [index, buffer] of items(parsed["buffers"]).entries()) {
    const uri = buffer["uri"];
    const found = typeof uri === "string" ? await bytesOf(uri, companions) : index === 0 ? bin : undefined;
    buffers.push(found);
  }
  return { document: parsed, buffers, companions, unpacked: { views: new Map(), left: MOST_UNPACKED } };
}

function chunksOf(bytes: Uint8Array<ArrayBuffer>): { json: Uint8Array; bin: Uint8Array<ArrayBuffer> | undefined } {
  const view = new DataView(bytes.buffer);
  if (bytes.length < 20 || view.getUint32(0, true) !== MAGIC) return { json: bytes, bin: undefined };
  let json: Uint8Array | undefined;
  let bin: Uint8Array<ArrayBuffer> | undefined;
  for (let at = 12; at + 8 <= bytes.length; ) {
    const length = view.getUint32(at, true);
    const kind = view.getUint32(at + 4, true);
    const chunk = bytes.subarray(at + 8, at + 8 + length);
    if (kind === JSON_CHUNK) json ??= chunk;
    else if (kind === BIN_CHUNK) bin ??= chunk;
    at += 8 + length;
  }
  if (json === undefined) throw new Error("the server sent a GLB file without a document");
  return { json, bin };
}

/** The bytes that a URI stands for: those in it, or a companion's. Nothing is fetched. */
export async function bytesOf(uri: string, companions: ReadonlyMap<string, Blob>): Promise<Uint8Array<ArrayBuffer> | undefined> {
  const inside = /^data:[^,]*?(;base64)?,/i.exec(uri);
  try {
    if (inside !== null) {
      const text = decodeURIComponent(uri.slice(inside[0].length));
      const plain = inside[1] === undefined ? text : atob(text.trim());
      return Uint8Array.from(plain, (c) => c.charCodeAt(0));
    }
    const name = decodeURIComponent(uri).replace(/^\.\//, "");
    const file = companions.get(uri) ?? companions.get(name) ?? [...companions].find(([path]) => path.endsWith(`/${name}`))?.[1];
    return file === undefined ? undefined : new Uint8Array(await file.arrayBuffer());
  } catch {
    // Broken escapes, broken base64, a file that is gone from the disk: as if there were none.
    return undefined;
  }
}

export function isItem(x: unknown): x is Item {
  return typeof x === "object" && x !== null && !Array.isArray(x);
}

/** A list of objects; what is none of it counts as an empty object, so that numbers stay right. */
export function items(x: unknown): readonly Item[] {
  return Array.isArray(x) ? x.map((item: unknown) => (isItem(item) ? item : {})) : [];
}

/** An object of one of the document's lists. */
export function itemAt({ document }: GltfFile, list: string, index: unknown): Item | undefined {
  const all = document[list];
  const found: unknown = Array.isArray(all) && typeof index === "number" ? all[index] : undefined;
  return isItem(found) ? found : undefined;
}

/** A member that is an object; empty when it is none. */
export function member(item: Item | undefined, key: string): Item {
  const found = item?.[key];
  return isItem(found) ? found : {};
}

/** A whole number from zero. */
export function whole(x: unknown): number | undefined {
  return typeof x === "number" && Number.isSafeInteger(x) && x >= 0 ? x : undefined;
}

/** So many finite numbers. */
export function numbers(x: unknown, count: number): readonly number[] | undefined {
  const fits = Array.isArray(x) && x.length === count && x.every((n) => Number.isFinite(n));
  return fits ? (x as readonly number[]) : undefined;
}

/** A text that says something. */
export function text(x: unknown): string | undefined {
  return typeof x === "string" && x !== "" ? x : undefined;
}

/** The bytes of a buffer view, decompressed. */
export function viewBytes(file: GltfFile, index: unknown): Uint8Array<ArrayBuffer> | undefined {
  const number = whole(index);
  const view = itemAt(file, "bufferViews", number);
  if (view === undefined || number === undefined) return undefined;
  const extensions = member(view, "extensions");
  const packed = extensions["KHR_meshopt_compression"] ?? extensions["EXT_meshopt_compression"];
  if (!isItem(packed)) return rangeOf(file, view);
  const known = file.unpacked.views.get(number);
  if (known !== undefined) return known;
  const [count, stride] = [whole(packed["count"]) ?? 0, whole(packed["byteStride"]) ?? 0];
  const source = rangeOf(file, packed);
  if (source === undefined || !(stride > 0 && stride <= 256) || count * stride > file.unpacked.left) return undefined;
  const out = new Uint8Array(count * stride);
  try {
    MeshoptDecoder.decodeGltfBuffer(out, count, stride, source, String(packed["mode"]), String(packed["filter"] ?? "NONE"));
  } catch {
    return undefined;
  }
  file.unpacked.left -= out.length;
  file.unpacked.views.set(number, out);
  return out;
}

function rangeOf(file: GltfFile, part: Item): Uint8Array<ArrayBuffer> | undefined {
  const bytes = file.buffers[whole(part["buffer"]) ?? -1];
  const from = whole(part["byteOffset"] ?? 0);
  const length = whole(part["byteLength"]);
  if (bytes === undefined || from === undefined || length === undefined || from + length > bytes.length) return undefined;
  return bytes.subarray(from, from + length);
}
