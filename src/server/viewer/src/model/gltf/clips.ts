/** Animation clips: which there are, and the values of their channels at a time. */

import { countOf, readNumbers } from "./accessors.ts";
import { type GltfFile, type Item, items, member, text, whole } from "./file.ts";
import { slerp } from "./matrices.ts";

/** A clip as a list shows it. */
export interface ClipFacts {
  readonly name: string;
  /** Seconds; 0 for a single pose. */
  readonly duration: number;
  /** Channels that can be played. */
  readonly channels: number;
  /** What is wrong with it, if something is. */
  readonly fault: string | undefined;
}

export type Path = "translation" | "rotation" | "scale" | "weights";

/** One animated property of a node. */
export interface Channel {
  readonly node: number;
  readonly path: Path;
  /** The value at a time, clamped to the first and last key. */
  at(seconds: number, out: number[]): void;
}

const LANES: Record<Path, number> = { translation: 3, rotation: 4, scale: 3, weights: 1 };
/** Channels of one clip. */
const MOST_CHANNELS = 1 << 16;

/** What clips a file has. */
export function clipsOf(file: GltfFile): readonly ClipFacts[] {
  return items(file.document["animations"]).map((animation, k) => {
    const samplers = items(animation["samplers"]);
    const wanted = items(animation["channels"]).slice(0, MOST_CHANNELS);
    let duration = 0;
    let usable = 0;
    let moved = 0;
    // Many channels share their times.
    const known = new Map<unknown, Float32Array | undefined>();
    for (const channel of wanted) {
      if (targetOf(channel) === undefined) continue;
      moved += 1;
      const input = samplers[whole(channel["sampler"]) ?? -1]?.["input"];
      if (!known.has(input)) known.set(input, timesOf(file, input));
      const times = known.get(input);
      if (times === undefined) continue;
      usable += 1;
      duration = Math.max(duration, times.at(-1) as number);
    }
    const broken = moved - usable;
    const fault = moved === 0 ? "moves nothing" : broken > 0 ? `${broken} of ${moved} channels have broken times and are left out` : undefined;
    return { name: text(animation["name"]) ?? `clip ${k + 1}`, duration, channels: usable, fault };
  });
}

/** The channels of a clip that can be played; `targets` says how many morph targets a node has. */
export function channelsOf(file: GltfFile, clip: number, targets: (node: number) => number): readonly Channel[] {
  const animation = items(file.document["animations"])[clip];
  const samplers = items(animation?.["samplers"]);
  const out: Channel[] = [];
  for (const channel of items(animation?.["channels"]).slice(0, MOST_CHANNELS)) {
    const target = targetOf(channel);
    const sampler = samplers[whole(channel["sampler"]) ?? -1];
    if (target === undefined || sampler === undefined) continue;
    const width = target.path === "weights" ? targets(target.node) : LANES[target.path];
    const curve = curveOf(file, sampler, LANES[target.path], width, target.path === "rotation");
    if (curve !== undefined) out.push({ ...target, at: curve });
  }
  return out;
}

function targetOf(channel: Item): { node: number; path: Path } | undefined {
  const target = member(channel, "target");
  const node = whole(target["node"]);
  const path = target["path"];
  return node !== undefined && typeof path === "string" && path in LANES ? { node, path: path as Path } : undefined;
}

/** Times of keys, when they are finite, from 0 on, and do not run backwards. */
function timesOf(file: GltfFile, input: unknown): Float32Array | undefined {
  const times = countOf(file, input) === 0 ? undefined : readNumbers(file, input, 1);
  if (times === undefined) return undefined;
  for (let k = 0; k < times.length; k++) {
    const time = times[k] as number;
    if (!Number.isFinite(time) || time < 0 || (k > 0 && time < (times[k - 1] as number))) return undefined;
  }
  return times;
}

type Curve = (seconds: number, out: number[]) => void;

function curveOf(file: GltfFile, sampler: Item, lanes: number, width: number, turns: boolean): Curve | undefined {
  const times = timesOf(file, sampler["input"]);
  const values = readNumbers(file, sampler["output"], lanes);
  const kind = sampler["interpolation"] ?? "LINEAR";
  if (times === undefined || values === undefined || width === 0 || values.some((x) => !Number.isFinite(x))) return undefined;
  const cubic = kind === "CUBICSPLINE";
  // In tangent, value and out tangent of each key stand side by side.
  const stride = cubic ? width * 3 : width;
  const first = cubic ? width : 0;
  if (values.length < times.length * stride) return undefined;
  const value = (key: number, out: number[]): void => {
    for (let k = 0; k < width; k++) out[k] = values[key * stride + first + k] as number;
  };
  return (seconds, out) => {
    const key = keyBefore(times, seconds);
    const from = times[key] as number;
    const span = key + 1 < times.length ? (times[key + 1] as number) - from : 0;
    if (seconds <= from || span <= 0 || kind === "STEP") return value(key, out);
    const share = Math.min(1, (seconds - from) / span);
    const [a, b] = [key * stride, (key + 1) * stride];
    if (cubic) {
      const [t2, t3] = [share * share, share * share * share];
      for (let k = 0; k < width; k++) {
        const start = values[a + width + k] as number;
        const leaving = (values[a + width * 2 + k] as number) * span;
        const end = values[b + width + k] as number;
        const arriving = (values[b + k] as number) * span;
        out[k] = (2 * t3 - 3 * t2 + 1) * start + (t3 - 2 * t2 + share) * leaving + (3 * t2 - 2 * t3) * end + (t3 - t2) * arriving;
      }
    } else if (turns) {
      slerp(values, a, values, b, share, out);
    } else {
      for (let k = 0; k < width; k++) out[k] = (values[a + k] as number) * (1 - share) + (values[b + k] as number) * share;
    }
  };
}

/** The last key that is not after a time; the first one when all are. */
function keyBefore(times: Float32Array, seconds: number): number {
  let [low, high] = [0, times.length];
  while (low + 1 < high) {
    const middle = (low + high) >> 1;
    if ((times[middle] as number) <= seconds) low = middle;
    else high = middle;
  }
  return low;
}
