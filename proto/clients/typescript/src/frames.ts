/**
 * Vertex buffers as they come over a stream: parts into frames, frames into a `Float32Array` that the caller owns, such
 * as the array behind a three.js buffer. The bytes of a part are looked at in place, wherever they begin; nothing is copied but the
 * numbers, once.
 */

import type { Frame as Part, Quality } from "./gen/pliant/v1/pliant_pb.js";
import { Frame_Attribute as Attribute, Frame_Encoding as Encoding } from "./gen/pliant/v1/pliant_pb.js";
import type { Vector } from "./rotation.js";
import { decodeSteps } from "./vertex_codec.js";

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
  /** The rotations found for handles that turn freely, by id, as axis times angle; in final frames. */
  readonly foundTurns: ReadonlyMap<string, Vector>;
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
  readonly foundTurns: ReadonlyMap<string, Vector>;
  /** What its positions are relative to; zero but for models far from the origin. */
  readonly origin: Vector;
  /** Whether it carries only some vertices and thus needs the frames before it. */
  readonly isPartial: boolean;

  /** `steps` are those of a frame of a stream with differences, four a vertex, by attribute. */
  constructor(
    private readonly parts: readonly Part[],
    private readonly steps?: ReadonlyMap<Attribute, Uint16Array>,
  ) {
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
    this.foundTurns = new Map(first.foundTurns.map(({ id, rotationVector: [x = 0, y = 0, z = 0] }) => [id, [x, y, z]]));
    this.origin = originOf(first);
    this.isPartial = parts.some((part) => part.indices.length > 0 || part.vertexCount === 0);
  }

  /** Whether it carries normals. */
  get hasNormals(): boolean {
    return this.parts.some((part) => part.attribute === Attribute.NORMAL);
  }

  /**
   * Writes x, y, z of every vertex that it carries into `target`, relative to `origin`; vertices that it does not carry keep their
   * place. `inModelSpace` adds the origin.
   */
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

  /** Whether it carries the gradients of the motion. */
  get hasGradients(): boolean {
    return this.parts.some((part) => part.attribute === Attribute.ROTATION);
  }

  /**
   * Writes the gradient of the motion around each vertex: into `rotations` unit quaternions x, y, z, w, into `stretches` xx, yy and
   * zz and into `shears` yz, zx and xy of a symmetric matrix. Splats turn and stretch by the rotation times that matrix, their
   * spherical harmonics turn by the rotation.
   */
  gradientsInto(rotations: Float32Array, stretches: Float32Array, shears: Float32Array): void {
    this.write(Attribute.ROTATION, 4, rotations);
    this.write(Attribute.STRETCH, 3, stretches);
    this.write(Attribute.SHEAR, 3, shears);
  }

  private write(attribute: Attribute, size: 3 | 4, target: Float32Array): void {
    for (const part of this.parts) {
      if (part.attribute === attribute) {
        writePart(part, size, target, this.steps?.get(attribute));
      }
    }
  }
}

/** What positions are relative to by a session or a part of a frame. */
export function originOf({ origin: [x = 0, y = 0, z = 0] }: { readonly origin: readonly number[] }): Vector {
  return [x, y, z];
}

/** Positions that came relative to an origin, in model space and 64 bits: far from the origin, 32 bits round them. */
export function inModelSpace(positions: Float32Array, origin: Vector): Float64Array<ArrayBuffer> {
  return Float64Array.from(positions, (value, k) => value + (origin[k % 3] as number));
}

function writePart(part: Part, size: 3 | 4, target: Float32Array, held: Uint16Array | undefined): void {
  const { indices, vertexCount, firstVertex } = part;
  checkPart(part);
  const last = indices.length > 0 ? (indices.at(-1) as number) + 1 : firstVertex + vertexCount;
  if (last * size > target.length) {
    throw new RangeError(`the frame reaches vertex ${last - 1}, the buffer holds ${target.length / size}`);
  }
  if (held !== undefined) {
    const range = held.subarray(firstVertex * 4, (firstVertex + vertexCount) * 4);
    unpackSteps(range, 4, indices, firstVertex, size, scale(part, size), target);
  } else if (part.encoding === Encoding.F32) {
    const { data } = part;
    if (indices.length === 0 && LITTLE_ENDIAN) {
      // Bytes need no alignment, so this is the one copy from the socket to the buffer.
      new Uint8Array(target.buffer, target.byteOffset + firstVertex * size * 4, data.byteLength).set(data);
    } else {
      unpackFloats(data, indices, firstVertex, size, target);
    }
  } else if (part.encoding === Encoding.U16) {
    unpackSteps(plainSteps(part, size), size, indices, firstVertex, size, scale(part, size), target);
  } else if (part.encoding === Encoding.MESHOPT) {
    const steps = new Uint16Array(vertexCount * 4);
    if (vertexCount > 0) decodeSteps(part.data, vertexCount, steps);
    unpackSteps(steps, 4, indices, firstVertex, size, scale(part, size), target);
  } else {
    throw new RangeError("a frame lists what differs from the one before, which is not here");
  }
}

/** Most vertices in a byte of the vertex codec: a block of 256 takes two bytes where all of it is zero. */
const VERTICES_A_BYTE = 128;

/**
 * Finds what is wrong with a part before anything is made of it: numbers that are not known, bytes that are too many or too few for
 * its vertices, and facts that are missing.
 */
function checkPart({ attribute, encoding, data, vertexCount, indices, boxMin, boxMax, number }: Part): void {
  if (Attribute[attribute] === undefined) {
    throw new RangeError(`the frame carries something (number ${attribute}) that this client does not know`);
  }
  if (indices.length > 0 && indices.length !== vertexCount) {
    throw new RangeError(`a part of a frame names ${indices.length} vertices and carries ${vertexCount}`);
  }
  if (encoding === Encoding.F32 || encoding === Encoding.U16) {
    const bytes = vertexCount * widthOf(attribute) * (encoding === Encoding.F32 ? 4 : 2);
    if (data.byteLength !== bytes) {
      throw new RangeError(`a part of a frame has ${data.byteLength} bytes, its vertices need ${bytes}`);
    }
  } else if (encoding === Encoding.MESHOPT || encoding === Encoding.DELTA) {
    if (vertexCount > VERTICES_A_BYTE * data.byteLength) {
      throw new RangeError(`a part of a frame has ${data.byteLength} bytes, which cannot be the code of ${vertexCount} vertices`);
    }
  } else {
    throw new RangeError(`the frame is packed in a way (number ${encoding}) that this client does not know`);
  }
  if (encoding === Encoding.DELTA && number === 0n) {
    throw new RangeError("a frame lists what differs from one that it does not name, which is not here");
  }
  if (encoding !== Encoding.F32 && attribute === Attribute.POSITION && (boxMin.length !== 3 || boxMax.length !== 3)) {
    throw new RangeError("a frame of steps says which box its numbers lie in; this one does not");
  }
}

/** Numbers of a vertex. */
function widthOf(attribute: Attribute): 3 | 4 {
  return attribute === Attribute.TANGENT || attribute === Attribute.ROTATION ? 4 : 3;
}

function unpackFloats(data: Uint8Array, indices: readonly number[], first: number, size: 3 | 4, target: Float32Array): void {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const count = data.byteLength / (size * 4);
  for (let k = 0, at = 0; k < count; k++) {
    const to = (indices.length === 0 ? first + k : (indices[k] as number)) * size;
    for (let c = 0; c < size; c++, at += 4) target[to + c] = view.getFloat32(at, true);
  }
}

/** Writes steps, of which every vertex has `stride`. */
function unpackSteps(
  steps: Uint16Array,
  stride: 3 | 4,
  indices: readonly number[],
  first: number,
  size: 3 | 4,
  { low, step }: { low: number[]; step: number[] },
  target: Float32Array,
): void {
  const [lx = 0, ly = 0, lz = 0, lw = 0] = low;
  const [sx = 0, sy = 0, sz = 0, sw = 0] = step;
  const listed = indices.length > 0;
  let to = first * size;
  for (let at = 0, k = 0; at < steps.length; at += stride, to += size, k++) {
    if (listed) to = (indices[k] as number) * size;
    target[to] = lx + sx * (steps[at] as number);
    target[to + 1] = ly + sy * (steps[at + 1] as number);
    target[to + 2] = lz + sz * (steps[at + 2] as number);
    if (size === 4) target[to + 3] = lw + sw * (steps[at + 3] as number);
  }
}

/** What 0 stands for, and what one step is worth. Normals, tangents and rotations lie between -1 and 1, stretches between -4 and 4. */
function scale(part: Part, size: 3 | 4): { low: number[]; step: number[] } {
  const { attribute } = part;
  const range = attribute === Attribute.STRETCH || attribute === Attribute.SHEAR ? 4 : 1;
  const directions = attribute !== Attribute.POSITION;
  const low = directions ? [-range, -range, -range, -range] : part.boxMin;
  const high = directions ? [range, range, range, range] : part.boxMax;
  return { low, step: Array.from({ length: size }, (_, k) => ((high[k] ?? 0) - (low[k] ?? 0)) / 65535) };
}

/** The steps of a U16 part, wherever its bytes begin. */
function plainSteps({ data, vertexCount }: Part, size: 3 | 4): Uint16Array {
  const steps = new Uint16Array(vertexCount * size);
  if (LITTLE_ENDIAN) {
    new Uint8Array(steps.buffer).set(data);
  } else {
    const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
    for (let k = 0; k < steps.length; k++) steps[k] = view.getUint16(k * 2, true);
  }
  return steps;
}

const LITTLE_ENDIAN = new Uint8Array(new Uint16Array([1]).buffer)[0] === 1;

/**
 * Joins the parts of one connection. Holds the parts of one frame at most and, in a stream with differences, the steps
 * of the frame before.
 */
export class Assembler {
  private parts: Part[] = [];
  /** The reference for the next frame. */
  private held: HeldFrame | undefined;

  /** `vertices` returns how many vertices the model has at a revision, if known. */
  constructor(private readonly vertices: (revision: number) => number | undefined = () => undefined) {}

  /**
   * Takes a part; answers the frame that it completes.
   *
   * @throws RangeError for parts of an invalid frame.
   */
  push(part: Part): Frame | undefined {
    if (part.part === 0) {
      this.parts = [];
    } else if (part.part !== this.parts.length || part.seq !== this.parts[0]?.seq) {
      // The beginning was missed, which a stream in order never does.
      throw new RangeError(`part ${part.part} of frame ${part.seq} came after ${this.parts.length} others`);
    }
    if (part.part >= part.parts || part.parts !== (this.parts[0] ?? part).parts) {
      throw new RangeError(`part ${part.part} of frame ${part.seq} says that there are ${part.parts}`);
    }
    this.parts.push(part);
    if (this.parts.length < part.parts) {
      return undefined;
    }
    const parts = this.parts;
    const before = this.held;
    this.parts = [];
    this.held = undefined;
    const sizes = sizesOf(parts, this.vertices(Number(part.revision)));
    if (part.number === 0n) return new Frame(parts);
    // Every frame gets steps of its own: those of the one before may not have been looked at yet.
    const steps = new Map<Attribute, Uint16Array>();
    for (const [attribute, vertices] of sizes) steps.set(attribute, new Uint16Array(vertices * 4));
    for (const one of parts) readSteps(one, steps.get(one.attribute) as Uint16Array, before);
    this.held = { number: part.number, parts, steps };
    return new Frame(parts, steps);
  }
}

/**
 * Checks the parts of a frame and counts its vertices by attribute: no more than `most`, and where later frames may
 * refer to it, one after the other without holes, under one number and in one box.
 */
function sizesOf(parts: readonly Part[], most = Number.POSITIVE_INFINITY): Map<Attribute, number> {
  const sizes = new Map<Attribute, number>();
  const number = parts[0]?.number ?? 0n;
  for (const part of parts) {
    const { seq, attribute, vertexCount, firstVertex, indices } = part;
    checkPart(part);
    const before = sizes.get(attribute) ?? 0;
    if (before + vertexCount > most || (indices.length === 0 && firstVertex + vertexCount > most)) {
      throw new RangeError(`frame ${seq} carries more vertices than the model has, which are ${most}`);
    }
    if (part.number !== number) {
      throw new RangeError(`frame ${seq} says in one part that its number is ${number}, in another ${part.number}`);
    }
    if (number !== 0n && (indices.length > 0 || firstVertex !== before)) {
      throw new RangeError(`frame ${seq} does not carry every vertex, so later frames cannot refer to it`);
    }
    if (number !== 0n && !hasBox(part, parts.find((one) => one.attribute === attribute))) {
      throw new RangeError(`frame ${seq} says in its parts that its numbers lie in several boxes`);
    }
    sizes.set(attribute, before + vertexCount);
  }
  return sizes;
}

/** A frame that differences may refer to. */
interface HeldFrame {
  readonly number: bigint;
  readonly parts: readonly Part[];
  readonly steps: ReadonlyMap<Attribute, Uint16Array>;
}

/** Reads the steps of a part to their place among `all` of its frame. */
function readSteps(part: Part, all: Uint16Array, before: HeldFrame | undefined): void {
  const { attribute, vertexCount, firstVertex, number } = part;
  const from = firstVertex * 4;
  const to = from + vertexCount * 4;
  const now = all.subarray(from, to);
  if (part.encoding === Encoding.U16) {
    const size = widthOf(attribute);
    const plain = plainSteps(part, size);
    for (let k = 0; k < vertexCount; k++) now.set(plain.subarray(k * size, (k + 1) * size), k * 4);
    return;
  }
  if (part.encoding !== Encoding.MESHOPT && part.encoding !== Encoding.DELTA) {
    throw new RangeError(`frame ${part.seq} is packed in a way (number ${part.encoding}) that does not allow differences`);
  }
  if (vertexCount > 0) decodeSteps(part.data, vertexCount, now);
  if (part.encoding === Encoding.MESHOPT) return;
  const base = before?.steps.get(attribute);
  const box = before?.parts.find((one) => one.attribute === attribute);
  if (before === undefined || base === undefined || before.number !== number - 1n || base.length !== all.length || !hasBox(part, box)) {
    throw new RangeError(
      `frame ${part.seq} lists what differs from the frame before, which is not here; open a new stream, or send the ` +
        "options again, to get a whole frame",
    );
  }
  // A Uint16Array keeps sums modulo 65536.
  for (let k = 0, at = from; at < to; k++, at++) now[k] = (now[k] as number) + (base[at] as number);
}

/** Whether two parts have their steps in the same box. */
function hasBox(part: Part, other: Part | undefined): boolean {
  const same = (a: readonly number[], b: readonly number[] | undefined) => a.length === b?.length && a.every((x, k) => x === b[k]);
  return same(part.boxMin, other?.boxMin) && same(part.boxMax, other?.boxMax);
}
