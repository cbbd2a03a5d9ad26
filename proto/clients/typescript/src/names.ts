/** Values of enums by their names in the schema, such as `encoding: "DELTA"`. */

import { type DescEnum, type DescField, type DescMessage, isMessage, type MessageInitShape } from "@bufbuild/protobuf";
import { PliantError } from "./errors.js";
import type * as schema from "./gen/pliant/v1/pliant_pb.js";

type Exported = (typeof schema)[keyof typeof schema];
/** The names of the enum that has the value. */
type NamesOf<Value, Enum = Exported> = Enum extends Record<string, string | number> ? (Value extends Enum[keyof Enum] ? keyof Enum : never) : never;

/** What a message is made of, where each value of an enum may also be its name. */
export type Named<T> = T extends Uint8Array | string | bigint | boolean | undefined | null
  ? T
  : T extends number
    ? // All numbers, or those of an enum.
      0.5 extends T
      ? T
      : T | NamesOf<T>
    : T extends readonly (infer Item)[]
      ? Named<Item>[]
      : { [Key in keyof T]: Named<T[Key]> };

/** What a message is made of, with numbers for names. */
export function numbered<D extends DescMessage>(schema: D, init: Named<MessageInitShape<D>>): MessageInitShape<D> {
  return fieldsOf(schema, init as Fields, "") as MessageInitShape<D>;
}

type Fields = Record<string, unknown>;

function fieldsOf(schema: DescMessage, init: Fields, place: string): Fields {
  if (isMessage(init)) return init;
  const fields = { ...init };
  for (const member of schema.members) {
    const value = init[member.localName];
    if (value === undefined || value === null) continue;
    if (member.kind === "oneof") {
      const chosen = value as { case?: string; value?: unknown };
      const field = member.fields.find(({ localName }) => localName === chosen.case);
      if (field !== undefined) fields[member.localName] = { ...chosen, value: valueOf(field, chosen.value, place) };
    } else {
      fields[member.localName] = valueOf(member, value, place);
    }
  }
  return fields;
}

function valueOf(field: DescField, value: unknown, before: string): unknown {
  const place = `${before}${field.localName}`;
  const one = (entry: unknown): unknown => {
    if (field.enum !== undefined) return numberOf(field.enum, entry, place);
    return field.message !== undefined && isFields(entry) ? fieldsOf(field.message, entry, `${place}.`) : entry;
  };
  return Array.isArray(value) && (field.enum ?? field.message) !== undefined ? value.map(one) : field.fieldKind === "map" ? value : one(value);
}

const isFields = (value: unknown): value is Fields => typeof value === "object" && value !== null && !(value instanceof Uint8Array);

function numberOf({ values }: DescEnum, value: unknown, place: string): unknown {
  if (typeof value !== "string") return value;
  const found = values.find(({ name }) => name === value);
  if (found !== undefined) return found.number;
  throw new PliantError("INVALID_ARGUMENT", `${place} is "${value}"; one of ${values.map(({ name }) => name).join(", ")} is allowed`);
}
