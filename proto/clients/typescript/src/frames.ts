/**
 * Vertex buffers as they come over a stream: parts into frames, frames into a `Float32Array` that the caller owns, such
 * as the array behind a three.js buffer. The bytes of a part are looked at in place, wherever they begin; nothing is copied but the
 * numbers, once.
 */

import type { Frame as Part, Quality } from "./gen/pliant/v1/pliant_pb.js";
import { Frame_Attribute as Attribute, Frame_Encoding as Encoding } from "./gen/pliant/v1/pliant_pb.js";

/** What is known of a frame beside its numbers. */
export interface FrameFacts {
  /** The pose that it answers. */
  readonly seq: number;
  /** The session's revision after it. */
  readonly revision: number;
  /** Whether no better frame for this pose will follow. */
  readonly final: boolean;
  /** Relative residual reached. */
  readonly residual: number;
  /** Estimate of the largest displacement still missing, as a fraction of the bounding box's diagonal. */
  readonly maxError: number;
  /** Milliseconds of solving. */
  readonly solveMs: number;
  /** Milliseconds of waiting for a compute slot. */
  readonly queueMs: number;
  /** Poses skipped since the previous frame. */
  readonly superseded: number;
  /** Bytes of numbers that came. */
  readonly bytes: number;
  /** Of a committed pose: the shape against the rest shape. */
  readonly quality?: Quality;
}

/** A whole frame, its numbers still packed. */
export class Frame implements FrameFacts {
  readonly seq: number;
  readonly revision: number;
  readonly final: boolean;
  readonly residual: number;
  readonly maxError: number;
  readonly solveMs: number;
  readonly queueMs: number;
  readonly superseded: number;
  readonly bytes: number;
  readonly quality?: Quality;
  /** Whether it carries only some vertices and thus needs the frames before it. */
  readonly isPartial: boolean;

  constructor(private readonly parts: readonly Part[]) {
    const first = parts[0];
    if (first === undefined) {
      throw new RangeError("a frame has at least one part");
    }
    this.seq = Number(first.seq);
    this.revision = Number(first.revision);
    this.final = first.final;
    this.residual = first.residual;
    this.maxError = first.maxError;
    this.solveMs = first.solveMs;
    this.queueMs = first.queueMs;
    this.superseded = first.superseded;
    this.bytes = parts.reduce((sum, part) => sum + part.data.byteLength, 0);
    if (first.quality !== undefined) {
      this.quality = first.quality;
    }
    this.isPartial = parts.some((part) => part.indices.length > 0 || part.vertexCount === 0);
  }

  /** Whether it carries normals. */
  get hasNormals(): boolean {
    return this.parts.some((part) => part.attribute === Attribute.NORMAL);
  }

  /** Writes x, y, z of every vertex that it carries into `target`; vertices that it does not carry keep their place. */
  positionsInto(target: Float32Array): void {
    this.write(Attribute.POSITION, 3, target);
  }

  /** Writes the normals that it carries into `target`. */
  normalsInto(target: Float32Array): void {
    this.write(Attribute.NORMAL, 3, target);
  }

  /** Writes the tangents (four numbers each) that it carries into `target`. */
  tangentsInto(target: Float32Array): void {
    this.write(Attribute.TANGENT, 4, target);
  }

  private write(attribute: Attribute, size: 3 | 4, target: Float32Array): void {
    for (const part of this.parts) {
      if (part.attribute === attribute) {
        writePart(part, size, target);
      }
    }
  }
}

function writePart(part: Part, size: 3 | 4, target: Float32Array): void {
  const { indices, vertexCount, firstVertex } = part;
  const last = indices.length > 0 ? (indices.at(-1) as number) + 1 : firstVertex + vertexCount;
  if (last * size > target.length) {
    throw new RangeError(`the frame reaches vertex ${last - 1}, the buffer holds ${target.length / size}`);
  }
  if (indices.length > 0 && indices.length !== vertexCount) {
    throw new RangeError(`a part of a frame names ${indices.length} vertices and carries ${vertexCount}`);
  }
  if (part.encoding === Encoding.F32) {
    const data = checked(part.data, vertexCount * size * 4);
    if (indices.length === 0 && LITTLE_ENDIAN) {
      // Bytes need no alignment, so this is the one copy from the socket to the buffer.
      new Uint8Array(target.buffer, target.byteOffset + firstVertex * size * 4, data.byteLength).set(data);
    } else {
      unpackFloats(data, indices, firstVertex, size, target);
    }
  } else if (part.encoding === Encoding.U16) {
    const data = checked(part.data, vertexCount * size * 2);
    unpackSteps(data, indices, firstVertex, size, scale(part, size), target);
  } else {
    throw new RangeError("this client reads F32 and U16 frames; ask for one of them in Options.output.encoding");
  }
}

function unpackFloats(data: Uint8Array, indices: readonly number[], first: number, size: 3 | 4, target: Float32Array): void {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const count = data.byteLength / (size * 4);
  for (let k = 0, at = 0; k < count; k++) {
    const to = (indices.length === 0 ? first + k : (indices[k] as number)) * size;
    for (let c = 0; c < size; c++, at += 4) target[to + c] = view.getFloat32(at, true);
  }
}

function unpackSteps(
  data: Uint8Array,
  indices: readonly number[],
  first: number,
  size: 3 | 4,
  { low, step }: { low: number[]; step: number[] },
  target: Float32Array,
): void {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const [lx = 0, ly = 0, lz = 0, lw = 0] = low;
  const [sx = 0, sy = 0, sz = 0, sw = 0] = step;
  const bytes = size * 2;
  const listed = indices.length > 0;
  let to = first * size;
  for (let at = 0, k = 0; at < data.byteLength; at += bytes, to += size, k++) {
    if (listed) to = (indices[k] as number) * size;
    target[to] = lx + sx * view.getUint16(at, true);
    target[to + 1] = ly + sy * view.getUint16(at + 2, true);
    target[to + 2] = lz + sz * view.getUint16(at + 4, true);
    if (size === 4) target[to + 3] = lw + sw * view.getUint16(at + 6, true);
  }
}

/** What 0 stands for, and what one step is worth. Normals and tangents lie between -1 and 1. */
function scale(part: Part, size: 3 | 4): { low: number[]; step: number[] } {
  const directions = part.attribute !== Attribute.POSITION;
  const low = directions ? [-1, -1, -1, -1] : part.boxMin;
  const high = directions ? [1, 1, 1, 1] : part.boxMax;
  if (low.length < 3 || high.length < 3) {
    throw new RangeError("a U16 frame says which box its numbers lie in; this one does not");
  }
  return { low, step: Array.from({ length: size }, (_, k) => ((high[k] ?? 0) - (low[k] ?? 0)) / 65535) };
}

const LITTLE_ENDIAN = new Uint8Array(new Uint16Array([1]).buffer)[0] === 1;

function checked(data: Uint8Array, bytes: number): Uint8Array {
  if (data.byteLength !== bytes) {
    throw new RangeError(`a part of a frame has ${data.byteLength} bytes, its vertices need ${bytes}`);
  }
  return data;
}

/** Puts parts together. Holds the parts of one frame at most. */
export class Assembler {
  private parts: Part[] = [];

  /** Takes a part; answers the frame that it completes. */
  push(part: Part): Frame | undefined {
    if (part.part === 0) {
      this.parts = [];
    } else if (part.part !== this.parts.length || part.seq !== this.parts[0]?.seq) {
      // The beginning was missed, which a stream in order never does.
      throw new RangeError(`part ${part.part} of frame ${part.seq} came after ${this.parts.length} others`);
    }
    this.parts.push(part);
    if (this.parts.length < part.parts) {
      return undefined;
    }
    const frame = new Frame(this.parts);
    this.parts = [];
    return frame;
  }
}
