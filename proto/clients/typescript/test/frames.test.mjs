import assert from "node:assert/strict";
import { test } from "node:test";
import { create } from "@bufbuild/protobuf";
import { Assembler, Frame, regionOf, schema } from "../dist/index.js";

const { Frame_Attribute: Attribute, Frame_Encoding: Encoding, FrameSchema } = schema;

function part(fields) {
  return create(FrameSchema, { seq: 1n, part: 0, parts: 1, ...fields });
}

function floats(...numbers) {
  return new Uint8Array(Float32Array.from(numbers).buffer);
}

test("parts become a frame, each at its place", () => {
  const assembler = new Assembler();
  assert.equal(assembler.push(part({ parts: 2, vertexCount: 1, data: floats(1, 2, 3) })), undefined);
  const frame = assembler.push(part({ part: 1, parts: 2, firstVertex: 1, vertexCount: 2, data: floats(4, 5, 6, 7, 8, 9) }));
  const target = new Float32Array(9);
  frame.positionsInto(target);
  assert.deepEqual([...target], [1, 2, 3, 4, 5, 6, 7, 8, 9]);
  assert.equal(frame.bytes, 36);
});

test("16-bit numbers lie between the corners of the frame's box", () => {
  const data = new Uint8Array(Uint16Array.from([0, 65535, 32768]).buffer);
  const frame = new Frame([part({ encoding: Encoding.U16, vertexCount: 1, data, boxMin: [-1, 10, 0], boxMax: [1, 20, 65535] })]);
  const target = new Float32Array(3);
  frame.positionsInto(target);
  assert.deepEqual([...target], [-1, 20, 32768]);
});

test("normals and tangents go where they belong", () => {
  const frame = new Frame([
    part({ parts: 3, vertexCount: 1, data: floats(1, 2, 3) }),
    part({ part: 1, parts: 3, attribute: Attribute.NORMAL, vertexCount: 1, data: floats(0, 0, 1) }),
    part({
      part: 2,
      parts: 3,
      attribute: Attribute.TANGENT,
      encoding: Encoding.U16,
      vertexCount: 1,
      data: new Uint8Array(Uint16Array.from([65535, 0, 0, 65535]).buffer),
    }),
  ]);
  const [normals, tangents] = [new Float32Array(3), new Float32Array(4)];
  frame.normalsInto(normals);
  frame.tangentsInto(tangents);
  assert.deepEqual([...normals], [0, 0, 1]);
  assert.deepEqual([...tangents], [1, -1, -1, 1]);
});

test("a frame of changed vertices leaves the others alone", () => {
  const frame = new Frame([part({ vertexCount: 2, indices: [0, 2], data: floats(9, 9, 9, 8, 8, 8) })]);
  const target = Float32Array.from([1, 1, 1, 2, 2, 2, 3, 3, 3]);
  frame.positionsInto(target);
  assert.ok(frame.isPartial);
  assert.deepEqual([...target], [9, 9, 9, 2, 2, 2, 8, 8, 8]);
});

test("numbers at an odd place in a message are read all the same", () => {
  const whole = new Uint8Array(13);
  whole.set(floats(1, 2, 3), 1);
  const frame = new Frame([part({ vertexCount: 1, data: whole.subarray(1) })]);
  const target = new Float32Array(3);
  frame.positionsInto(target);
  assert.deepEqual([...target], [1, 2, 3]);
  // Into a buffer that begins at another place than its memory does.
  const larger = new Float32Array(8);
  frame.positionsInto(larger.subarray(1, 5));
  assert.deepEqual([...larger], [0, 1, 2, 3, 0, 0, 0, 0]);
  const steps = new Uint8Array(13);
  steps.set(new Uint8Array(Uint16Array.from([0, 65535, 32768, 65535, 0, 1]).buffer), 1);
  const box = { encoding: Encoding.U16, boxMin: [-1, 10, 0], boxMax: [1, 20, 65535] };
  const moved = new Frame([part({ ...box, vertexCount: 2, indices: [0, 2], data: steps.subarray(1) })]);
  const three = new Float32Array(9);
  moved.positionsInto(three);
  assert.deepEqual([...three], [-1, 20, 32768, 0, 0, 0, 1, 10, 1]);
});

test("what does not fit is refused, not written elsewhere", () => {
  const write = (fields, size = 3) => new Frame([part(fields)]).positionsInto(new Float32Array(size));
  assert.throws(() => write({ vertexCount: 2, data: floats(1, 2, 3, 4, 5, 6) }), /reaches vertex 1, the buffer holds 1/);
  assert.throws(() => write({ vertexCount: 1, data: floats(1, 2) }), /8 bytes, its vertices need 12/);
  assert.throws(() => write({ vertexCount: 2, indices: [0], data: floats(1, 2, 3, 4, 5, 6) }), /names 1 vertices and carries 2/);
  assert.throws(() => write({ encoding: Encoding.U16, vertexCount: 1, data: new Uint8Array(6) }), /box/);
  assert.throws(() => write({ encoding: Encoding.MESHOPT, vertexCount: 1, data: new Uint8Array(6) }), /F32 and U16/);
  const assembler = new Assembler();
  assert.throws(() => assembler.push(part({ part: 1, parts: 2 })), /after 0 others/);
});

test("indices become runs where there are runs", () => {
  const { region } = regionOf([1, 3, 4, 5, 6, 7, 20, 21]);
  assert.deepEqual([...region.value.indices], [1, 20, 21]);
  assert.deepEqual(region.value.ranges.map(({ first, count }) => [first, count]), [[3, 5]]);
});
