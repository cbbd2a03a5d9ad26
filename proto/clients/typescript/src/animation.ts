/** Animations: a clip drives the session's model, and its frames come in order, as an asynchronous iterator. */

import type { MessageInitShape } from "@bufbuild/protobuf";
import { fromBinary } from "@bufbuild/protobuf";
import { PliantError } from "./errors.js";
import type { Frame } from "./frames.js";
import { Assembler } from "./frames.js";
import type { AnimationReport, Frame as Part } from "./gen/pliant/v1/pliant_pb.js";
import { AnimateOptionsSchema, FrameSchema } from "./gen/pliant/v1/pliant_pb.js";
import type { Named } from "./names.js";
import type { CallOptions } from "./transport.js";
import { jsonOf } from "./transport.js";

/** How a clip drives a model; what is absent has the server's default. */
export type AnimateOptions = Named<Omit<MessageInitShape<typeof AnimateOptionsSchema>, "sessionId" | "source" | "rig" | "window" | "$typeName">> & {
  /** A clip of the model itself, by name or by number from 0. */
  clip?: string | number;
  /** A BVH file. */
  bvh?: Blob | Uint8Array<ArrayBuffer> | string;
  /**
   * Which bones the clip's joints drive: what a rig file holds. A model's own clip drives its skin without one, a BVH file the rig
   * that `pliant rig` makes of an upright figure.
   */
  rig?: unknown;
};

/** A frame of an animation. Its numbers are written into arrays of the caller's. */
export interface AnimatedFrame {
  /** Its number in the animation, from 0. */
  readonly index: number;
  /** Frames of the whole animation, wanted or not. */
  readonly count: number;
  /** When it is, in seconds of the clip. */
  readonly time: number;
  /** Where the root bone has carried the model: x, y, z, to be added after the turn. */
  readonly rootTranslation: readonly number[];
  /** How it has turned it: a unit quaternion x, y, z, w. */
  readonly rootRotation: readonly number[];
  /** Digest of the positions as the root bone sees them. */
  readonly digest: string;
  /** The numbers, and what is known of their solve. */
  readonly frame: Frame;
}

/** How often a lost connection is reopened before a frame arrives, and the first wait in milliseconds. */
const ATTEMPTS = 6;
const PAUSE = 100;

/** Opens the body of an animation. */
export type AnimationRoute = (form: FormData, call: CallOptions) => Promise<Response>;

/**
 * The frames of an animation, in order and none left out: `for await (const frame of session.animate(…))`. The server works only a
 * little ahead of the reader; leaving the loop stops it. A lost connection is reopened at the next frame.
 */
export class Animation implements AsyncIterable<AnimatedFrame> {
  private told: AnimationReport | undefined;
  private again = 0;

  constructor(
    private readonly route: AnimationRoute,
    private readonly options: AnimateOptions,
    private readonly call: CallOptions = {},
  ) {}

  /** Totals, warnings and what the handles of the rig hold, once all frames have come. */
  get report(): AnimationReport | undefined {
    return this.told;
  }

  /** How often a lost connection was reopened. */
  get reconnects(): number {
    return this.again;
  }

  async *[Symbol.asyncIterator](): AsyncGenerator<AnimatedFrame, void, void> {
    const first = this.options.first ?? 0;
    let next = first;
    for (let attempt = 0; ; ) {
      let lost: unknown;
      try {
        const count = this.options.count ? first + this.options.count - next : 0;
        const form = formOf({ ...this.options, first: next, count });
        // Tries after the first are counted here.
        const call = attempt === 0 ? this.call : { ...this.call, patience: 0 };
        for await (const frame of this.frames(await this.route(form, call))) {
          attempt = 0;
          next = frame.index + 1;
          yield frame;
        }
        if (this.told !== undefined) return;
        lost = new PliantError("UNAVAILABLE", "the server ended the animation");
      } catch (error) {
        if (this.call.signal?.aborted === true || (error instanceof PliantError && !error.isTransient)) throw error;
        if (next === first && attempt === 0 && error instanceof PliantError) throw error;
        lost = error;
      }
      if (++attempt > ATTEMPTS) throw lost;
      this.again += 1;
      await new Promise((resolve) => setTimeout(resolve, PAUSE * 2 ** attempt));
    }
  }

  private async *frames(response: Response): AsyncGenerator<AnimatedFrame, void, void> {
    const assembler = new Assembler();
    for await (const part of partsOf(response)) {
      const { animated } = part;
      if (animated === undefined) continue;
      if (part.parts === 0) {
        this.told = animated.report ?? this.told;
        continue;
      }
      const frame = assembler.push(part);
      if (frame === undefined) continue;
      const { index, count, time, rootTranslation, rootRotation, digest } = animated;
      yield { index, count, time, rootTranslation, rootRotation, digest, frame };
    }
  }
}

/** The form that asks for an animation. */
export function formOf({ clip, bvh, rig, ...options }: AnimateOptions): FormData {
  const json = jsonOf(AnimateOptionsSchema, options) as object;
  const more = { ...(clip !== undefined && { clip: String(clip) }), ...(rig !== undefined && { rig }) };
  const form = new FormData();
  form.append("options", new Blob([JSON.stringify({ ...json, ...more })], { type: "application/json" }));
  if (bvh !== undefined) form.append("clip", bvh instanceof Blob ? bvh : new Blob([bvh]), "clip.bvh");
  return form;
}

/** Messages in a row, each after its length. */
async function* partsOf(response: Response): AsyncGenerator<Part, void, void> {
  if (response.body === null) return;
  const reader = response.body.getReader();
  let held = new Uint8Array(0);
  try {
    for (;;) {
      const message = firstMessage(held);
      if (message !== undefined) {
        yield fromBinary(FrameSchema, held.subarray(message.start, message.end));
        held = held.subarray(message.end);
        continue;
      }
      const { done, value } = await reader.read();
      if (done) {
        if (held.length > 0) throw new PliantError("UNAVAILABLE", "the animation broke off in the middle of a frame");
        return;
      }
      const joined = new Uint8Array(held.length + value.length);
      joined.set(held);
      joined.set(value, held.length);
      held = joined;
    }
  } finally {
    // Who leaves early wants no more; what is cut off has nothing to cancel.
    await reader.cancel().catch(() => undefined);
  }
}

/** Where the first message begins and ends, when all of it is there. */
function firstMessage(bytes: Uint8Array): { start: number; end: number } | undefined {
  let length = 0;
  for (let k = 0; k < Math.min(bytes.length, 5); k++) {
    const byte = bytes[k] as number;
    length += (byte & 0x7f) * 2 ** (7 * k);
    if (byte < 0x80) {
      const end = k + 1 + length;
      return end <= bytes.length ? { start: k + 1, end } : undefined;
    }
  }
  if (bytes.length >= 5) throw new RangeError("the animation's frames have no lengths");
  return undefined;
}
