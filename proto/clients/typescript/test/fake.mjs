/** A WebSocket that a test holds the other end of, and messages to send through it. */

import { create, fromBinary, toBinary } from "@bufbuild/protobuf";
import { MeshoptEncoder } from "meshoptimizer/encoder";
import { schema } from "../dist/index.js";

export class FakeSocket {
  static OPEN = 1;
  OPEN = 1;
  readyState = 0;
  bufferedAmount = 0;
  sent = [];

  open() {
    this.readyState = 1;
    this.onopen?.();
  }

  send(bytes) {
    this.sent.push(fromBinary(schema.DeformRequestSchema, bytes).message);
  }

  /** The server says something. */
  say(message) {
    const bytes = toBinary(schema.DeformResponseSchema, create(schema.DeformResponseSchema, { message }));
    this.onmessage?.({ data: bytes.slice().buffer });
  }

  /** The connection goes. */
  drop(code = 1006, reason = "") {
    this.readyState = 3;
    this.onclose?.({ code, reason });
  }

  close() {
    this.readyState = 3;
  }

  /** What was sent of one kind. */
  of(kind) {
    return this.sent.filter((message) => message.case === kind).map((message) => message.value);
  }
}

/** A frame of 32-bit floats in one part. */
export function frame(seq, numbers, more = {}) {
  const data = new Uint8Array(Float32Array.from(numbers).buffer);
  return { case: "frame", value: { seq: BigInt(seq), part: 0, parts: 1, vertexCount: numbers.length / 3, data, final: true, ...more } };
}

/** The code of steps, four a vertex; `MeshoptEncoder.ready` comes before. */
export const coded = (steps, level = 2, version = 1) =>
  MeshoptEncoder.encodeVertexBufferLevel(new Uint8Array(steps.buffer), steps.length / 4, 8, level, version);

/** A frame of a stream that tells differences: these steps as they are, or from those of the frame before. */
export function toldFrame(seq, number, steps, before) {
  const encoding = before === undefined ? schema.Frame_Encoding.MESHOPT : schema.Frame_Encoding.DELTA;
  const data = coded(before === undefined ? steps : steps.map((step, k) => step - before[k]));
  const box = { boxMin: [0, 0, 0], boxMax: [65535, 65535, 65535] };
  return frame(seq, [], { number: BigInt(number), encoding, vertexCount: steps.length / 4, data, ...box });
}

/** Lets promises that are ready run. */
export const settled = () => new Promise((resolve) => setTimeout(resolve, 0));
