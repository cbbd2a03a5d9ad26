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

/** Refuses poses that no server could read. An empty list is a field that is not given. */
export function checkPoses(entries: readonly unknown[]): void {
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
