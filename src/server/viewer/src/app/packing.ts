/** How frames come, where the user has no wish of their own. */

import { schema } from "pliant-client";
import * as s from "./signals.ts";

/** Above this many vertices frames come as 16-bit numbers. */
const MANY_VERTICES = 100_000;

/** Whether the server is this machine, whose frames take no wire. */
function isHere(): boolean {
  const { hostname } = location;
  return hostname === "localhost" || hostname.endsWith(".localhost") || hostname === "[::1]" || hostname.startsWith("127.");
}

/**
 * The encoding of frames of a model: from another machine what differs, which is a fraction of the bytes; from this one, where bytes
 * cost nothing and packing them does, whole numbers, of large models half as long.
 */
export function frameEncoding(vertices: number): schema.Frame_Encoding {
  const { encoding } = s.settings.peek();
  if (encoding !== "AUTO") return schema.Frame_Encoding[encoding];
  if (!isHere()) return schema.Frame_Encoding.DELTA;
  return vertices > MANY_VERTICES ? schema.Frame_Encoding.U16 : schema.Frame_Encoding.F32;
}
