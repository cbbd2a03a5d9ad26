/** A WebSocket that a test holds the other end of, and messages to send through it. */

import { create, fromBinary, toBinary } from "@bufbuild/protobuf";
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

/** Lets promises that are ready run. */
export const settled = () => new Promise((resolve) => setTimeout(resolve, 0));
