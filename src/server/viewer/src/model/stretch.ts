/** How far edges are from their rest length, as colours: blue where they are shorter, orange where they are longer. */

import type { SurfaceReport } from "./report.ts";

/** The change at which a colour is full: lengths times this, or divided by it. */
export const FULL_STRETCH = 1.5;

/** Measures a shape against the rest shape. Keeps its working memory. */
export class StretchMeter {
  private readonly sums: Float32Array;
  private readonly counts: Uint8Array;
  private readonly restLengths: Float32Array;

  constructor(
    rest: Float32Array,
    private readonly indices: Uint32Array,
    private readonly report: SurfaceReport,
  ) {
    this.sums = new Float32Array(report.places);
    this.counts = new Uint8Array(report.places);
    this.restLengths = Float32Array.from({ length: indices.length }, (_, k) => {
      const next = k % 3 === 2 ? k - 2 : k + 1;
      return length(rest, indices[k] as number, indices[next] as number);
    });
  }

  /** Writes for every render vertex the mean of log(length / rest length) of its edges. */
  measure(positions: Float32Array, out: Float32Array): void {
    const { sums, counts, restLengths, indices } = this;
    const { placeOf } = this.report;
    sums.fill(0);
    counts.fill(0);
    for (let k = 0; k < indices.length; k++) {
      const rest = restLengths[k] as number;
      if (rest <= 0) continue;
      const i = indices[k] as number;
      const j = indices[k % 3 === 2 ? k - 2 : k + 1] as number;
      const change = Math.log(Math.max(1e-6, length(positions, i, j) / rest));
      const a = placeOf[i] as number;
      const b = placeOf[j] as number;
      if ((counts[a] as number) < 255) {
        sums[a]! += change;
        counts[a]! += 1;
      }
      if ((counts[b] as number) < 255) {
        sums[b]! += change;
        counts[b]! += 1;
      }
    }
    for (let v = 0; v < placeOf.length; v++) {
      const place = placeOf[v] as number;
      out[v] = (sums[place] as number) / Math.max(1, counts[place] as number);
    }
  }
}

function length(positions: Float32Array, i: number, j: number): number {
  const x = (positions[i * 3] as number) - (positions[j * 3] as number);
  const y = (positions[i * 3 + 1] as number) - (positions[j * 3 + 1] as number);
  const z = (positions[i * 3 + 2] as number) - (positions[j * 3 + 2] as number);
  return Math.sqrt(x * x + y * y + z * z);
}

const LONGER = [242, 140, 56] as const;
const SHORTER = [64, 132, 244] as const;

/** Writes the colour of a change (see `measure`) with its strength as alpha. */
export function stretchColour(change: number, out: Uint8Array, at: number): void {
  const strength = Math.min(1, Math.abs(change) / Math.log(FULL_STRETCH));
  const [r, g, b] = change > 0 ? LONGER : SHORTER;
  out[at] = r;
  out[at + 1] = g;
  out[at + 2] = b;
  out[at + 3] = Math.round(255 * strength);
}
