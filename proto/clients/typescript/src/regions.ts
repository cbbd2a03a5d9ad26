/** Sets of render vertices as the schema writes them: runs where there are runs, single indices elsewhere. */

import type { Region } from "./gen/pliant/v1/pliant_pb.js";
import { RegionSchema } from "./gen/pliant/v1/pliant_pb.js";
import { create } from "@bufbuild/protobuf";

/** Runs shorter than this are cheaper as single indices. */
const SHORTEST_RUN = 4;

/** The region that holds exactly these render vertices. `indices` must be ascending and without repeats. */
export function regionOf(indices: ArrayLike<number>): Region {
  const single: number[] = [];
  const ranges: { first: number; count: number }[] = [];
  for (let k = 0; k < indices.length; ) {
    const first = indices[k] as number;
    let count = 1;
    while (k + count < indices.length && indices[k + count] === first + count) {
      count += 1;
    }
    if (count >= SHORTEST_RUN) {
      ranges.push({ first, count });
    } else {
      for (let j = 0; j < count; j++) {
        single.push(first + j);
      }
    }
    k += count;
  }
  return create(RegionSchema, { region: { case: "vertices", value: { indices: single, ranges } } });
}
