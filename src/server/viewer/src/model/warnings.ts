/** What the server noticed about a model, for people. */

import type { schema } from "pliant-client";

/** Where places begin in a message: what stands before is what it is about. */
const PLACE = /,? (?:first )?(?:[\d,]+ (?:edges long|vertices), )?(?:at (?:render vertex|triangle) [\d,]+|between render vertices)/;

/** What a warning is about, without its places: a line. */
export function headlineOf(message: string): string {
  const at = message.search(PLACE);
  return at > 0 ? message.slice(0, at) : message;
}

/** Places of a warning that its message does not name already. */
export function otherPlaces({ message, where }: Pick<schema.Warning, "message" | "where">): string | undefined {
  const others = where.split("; ").filter((place) => !message.includes(place));
  return others.length === 0 ? undefined : others.join("; ");
}

/** A place to show: a render vertex, or a point of the rest shape. */
export type Place = { readonly vertex: number } | { readonly point: readonly [number, number, number] };

/** The places of a warning that can be shown. */
export function placesOf({ vertices, position }: Pick<schema.Warning, "vertices" | "position">): readonly Place[] {
  const points = Array.from({ length: Math.floor(position.length / 3) }, (_, k) => ({
    point: [position[k * 3] as number, position[k * 3 + 1] as number, position[k * 3 + 2] as number] as const,
  }));
  return [...vertices.map((vertex) => ({ vertex })), ...points];
}
