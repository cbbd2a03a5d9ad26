/** Checks poses before they are sent; an error names its handle and field. */

import { PliantError } from "./errors.js";
import { HandlePoseSchema } from "./gen/pliant/v1/pliant_pb.js";

/** Names of a pose's fields, as the schema has them. */
const FIELDS: readonly string[] = HandlePoseSchema.fields.map(({ localName }) => localName);

/** How many numbers those fields take that are lists; the others are true or false. */
const COUNTS: Readonly<Record<string, readonly number[]>> = {
  translation: [3],
  rotation: [4],
  rotationVector: [3],
  scale: [1, 3],
  pivot: [3],
};

/**
 * The pose of a handle with targets: where its vertices are wanted, x, y, z of each in the order of the model's vertices, relative to
 * the session's `origin` as frames are, and factors of the stiffness, one for all or one for each. What is not given stays as before. `normals` are across the planes that vertices of a `tangential` handle are wanted in. With `first` they are of the vertices from that one of the handle on.
 */
export function targets(positions?: Float32Array, weights?: Float32Array, first?: number, normals?: Float32Array): VertexTargetsPose {
  if (positions !== undefined && positions.length % 3 !== 0) {
    throw new PliantError("INVALID_ARGUMENT", `targets: ${positions.length} numbers, 3 for each vertex are allowed`);
  }
  const forAll = weights?.length === 1 && first === undefined;
  if (positions !== undefined && weights !== undefined && !forAll && 3 * weights.length !== positions.length) {
    throw new PliantError("INVALID_ARGUMENT", `targets: ${weights.length} weights, one for each of ${positions.length / 3} vertices is allowed`);
  }
  if (normals !== undefined && (normals.length % 3 !== 0 || (positions !== undefined && positions.length !== normals.length))) {
    throw new PliantError("INVALID_ARGUMENT", `targets: ${normals.length} numbers of normals, 3 for each vertex are allowed`);
  }
  return { targets: { positions: littleEndian(positions), weights: littleEndian(weights), first, normals: littleEndian(normals) } };
}

/** What `targets` makes. */
export interface VertexTargetsPose {
  targets: { positions: Uint8Array<ArrayBuffer>; weights: Uint8Array<ArrayBuffer>; first: number | undefined; normals: Uint8Array<ArrayBuffer> };
}

/** 32-bit floats as the schema carries them. */
export function littleEndian(numbers: Float32Array = new Float32Array()): Uint8Array<ArrayBuffer> {
  const view = new DataView(new ArrayBuffer(4 * numbers.length));
  numbers.forEach((value, k) => view.setFloat32(4 * k, value, true));
  return new Uint8Array(view.buffer);
}

/** Refuses poses that no server could read. An empty list is a field that is not given. */
export function checkPoses(entries: readonly unknown[]): void {
  if (!Array.isArray(entries)) {
    throw new PliantError("INVALID_ARGUMENT", `poses: ${written(entries)}, a list such as [{ id: "head", pose: { translation: [0, 1, 0] } }] is allowed`);
  }
  for (const entry of entries) {
    const { id, pose } = (entry ?? {}) as { id?: unknown; pose?: unknown };
    if (pose === undefined || pose === null) continue;
    const refuse = (problem: string): never => {
      throw new PliantError("INVALID_ARGUMENT", `handle ${JSON.stringify(id)}: pose${problem}`);
    };
    if (typeof pose !== "object") refuse(` is ${written(pose)}, an object with ${FIELDS.join(", ")} is allowed`);
    for (const [field, value] of Object.entries(pose as object)) {
      if (field.startsWith("$") || value === undefined) continue;
      if (!FIELDS.includes(field)) refuse(`: ${field} is not a field of it; allowed are ${FIELDS.join(", ")}`);
      if (field === "targets") {
        if (typeof value !== "object") refuse(`.targets is ${written(value)}, what targets() makes is allowed`);
        continue;
      }
      if (field === "guide") {
        if (typeof value !== "object") refuse(`.guide is ${written(value)}, an object with positions, twists, scales is allowed`);
        continue;
      }
      const counts = COUNTS[field];
      if (counts === undefined) {
        if (typeof value !== "boolean") refuse(`.${field} is ${written(value)}, true or false is allowed`);
      } else if (!isNumbers(value, [0, ...counts])) {
        refuse(`.${field} is ${written(value)}, a list of ${counts.join(" or ")} numbers is allowed`);
      }
    }
  }
}

/** Whether something is a list of numbers, so many of them. */
export function isNumbers(value: unknown, counts: readonly number[]): boolean {
  if (!Array.isArray(value) && !ArrayBuffer.isView(value)) return false;
  const numbers = Array.from(value as ArrayLike<unknown>);
  return counts.includes(numbers.length) && numbers.every((x) => typeof x === "number");
}

/** A value as an error shows it: short. */
export function written(value: unknown): string {
  const plain = typeof value === "number" || typeof value === "bigint" || value === undefined;
  const text = plain ? String(value) : (JSON.stringify(value, (_, inner: unknown) => (typeof inner === "bigint" ? String(inner) : inner)) ?? typeof value);
  return text.length > 60 ? `${text.slice(0, 60)}…` : text;
}
