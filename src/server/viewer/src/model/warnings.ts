/** What the server noticed about a model, for people. */

import type { schema } from "pliant-client";

/** Places of a warning that its message does not name already. */
export function otherPlaces({ message, where }: Pick<schema.Warning, "message" | "where">): string | undefined {
  const others = where.split("; ").filter((place) => !message.includes(place));
  return others.length === 0 ? undefined : others.join("; ");
}
