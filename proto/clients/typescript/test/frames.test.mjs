import assert from "node:assert/strict";
import { test } from "node:test";
import { create } from "@bufbuild/protobuf";
import { MeshoptEncoder } from "meshoptimizer/encoder";
import { Assembler, Frame, regionOf, schema } from "../dist/index.js";
import { decodeSteps } from "../dist/vertex_codec.js";
import { coded } from "./fake.mjs";

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
  const box = { boxMin: [0, 0, 0], boxMax: [1, 1, 1] };
  assert.throws(() => write({ ...box, encoding: Encoding.MESHOPT, vertexCount: 1, data: new Uint8Array(60) }), /unknown version/);
  assert.throws(() => write({ ...box, encoding: Encoding.DELTA, vertexCount: 1, data: new Uint8Array(60) }), /not here/);
  assert.throws(() => write({ ...box, encoding: 9, vertexCount: 1, data: new Uint8Array(60) }), /number 9/);
  const assembler = new Assembler();
  assert.throws(() => assembler.push(part({ part: 1, parts: 2 })), /after 0 others/);
});

test("a frame that is none is found when it comes, before anything is made of it", () => {
  const refuses = (parts, words, vertices) => {
    const assembler = new Assembler(vertices && (() => vertices));
    assert.throws(() => parts.forEach((one) => assembler.push(part(one))), words);
  };
  const box = { boxMin: [0, 0, 0], boxMax: [1, 1, 1] };
  const steps = (vertices, more) => ({ ...box, number: 1n, encoding: Encoding.U16, vertexCount: vertices, data: new Uint8Array(vertices * 6), ...more });
  refuses([steps(1, { parts: 0 })], /says that there are 0/);
  refuses([steps(1, { parts: 2 }), steps(1, { part: 1, parts: 3, firstVertex: 1 })], /says that there are 3/);
  refuses([steps(1, { attribute: 9 })], /number 9/);
  refuses([steps(1, { attribute: 9, number: 0n })], /number 9/);
  refuses([steps(1, { boxMin: [] })], /box/);
  refuses([steps(1, { boxMin: [], number: 0n })], /box/);
  refuses([steps(1, { encoding: 8, number: 0n })], /number 8/);
  refuses([steps(1, { encoding: Encoding.DELTA, number: 0n })], /does not name/);
  refuses([steps(2, { data: new Uint8Array(6), number: 0n })], /6 bytes, its vertices need 12/);
  refuses([steps(2, { indices: [1], number: 0n })], /names 1 vertices and carries 2/);
  // Holes, overlaps, and parts of several frames.
  const second = { part: 1, parts: 2, firstVertex: 2 };
  refuses([steps(2, { parts: 2 }), steps(2, { ...second, firstVertex: 1 })], /does not carry every vertex/);
  refuses([steps(2, { parts: 2 }), steps(2, { ...second, firstVertex: 3 })], /does not carry every vertex/);
  refuses([steps(2, { firstVertex: 1 })], /does not carry every vertex/);
  refuses([steps(2, { parts: 2 }), steps(2, { ...second, number: 2n })], /in another 2/);
  refuses([steps(2, { parts: 2 }), steps(2, { ...second, number: 0n })], /in another 0/);
  refuses([steps(2, { parts: 2 }), steps(2, { ...second, boxMax: [1, 1, 2] })], /several boxes/);
  // Few bytes that speak of many vertices.
  for (const encoding of [Encoding.MESHOPT, Encoding.DELTA]) {
    refuses([steps(1, { encoding, vertexCount: 2 ** 32 - 1, data: new Uint8Array(60) })], /cannot be the code of 4294967295/);
  }
  refuses([steps(1, { encoding: Encoding.MESHOPT, vertexCount: 6000, data: new Uint8Array(60) })], /the model has, which are 5999/, 5999);
  refuses([steps(1, { firstVertex: 3, number: 0n })], /the model has, which are 3/, 3);
});

test("code that is short says so", async () => {
  await MeshoptEncoder.ready;
  const code = coded(Uint16Array.from({ length: 64 }, (_, k) => k * 999));
  for (let length = 25; length < code.length; length++) {
    try {
      decodeSteps(code.subarray(0, length), 16, new Uint16Array(64));
    } catch (error) {
      assert.doesNotMatch(error.message, /-\d+ bytes/);
    }
  }
  const zero = new Uint8Array(27);
  zero.set([0xa1, 0xaa, 0xaa]);
  decodeSteps(zero, 4, new Uint16Array(16));
  assert.throws(() => decodeSteps(zero.subarray(0, 26), 4, new Uint16Array(16)), /ends early/);
});

/** Random numbers that are the same in every run. */
function draw(seed) {
  let state = seed;
  return () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return state / 2 ** 32;
  };
}

test("the vertex codec gives back what was packed, in every version and for every kind of numbers", async () => {
  await MeshoptEncoder.ready;
  const random = draw(7);
  const kinds = [
    () => 0,
    () => random() * 65536,
    (k) => k * 3,
    (k) => 32768 + Math.sin(k / 9) * 2000,
    (k) => (k & 1) * 65535,
    () => (random() < 0.05 ? random() * 65536 : 0),
    () => random() * 9 - 4,
  ];
  for (const kind of kinds) {
    for (const count of [1, 15, 16, 17, 255, 256, 257, 700]) {
      const steps = Uint16Array.from({ length: count * 4 }, (_, k) => (k % 4 === 3 ? 0 : kind(k)));
      for (const [level, version] of [[0, 0], [0, 1], [1, 1], [2, 1], [3, 1]]) {
        const code = coded(steps, level, version);
        const out = new Uint16Array(count * 4);
        decodeSteps(code, count, out);
        assert.deepEqual(out, steps, `${count} vertices, level ${level}, version ${version}`);
        // Whatever is done to it, it is read or refused.
        for (let k = 0; k < 8; k++) {
          const bad = code.slice(0, random() < 0.3 ? random() * code.length : code.length);
          if (bad.length > 0) bad[Math.floor(random() * bad.length)] ^= 1 << (random() * 8);
          try {
            decodeSteps(bad, count, out);
          } catch (error) {
            assert.ok(error instanceof RangeError, String(error));
          }
        }
        assert.throws(() => decodeSteps(code.subarray(0, code.length - 1), count, new Uint16Array(count * 4)), RangeError);
      }
    }
  }
});

test("frames that tell what differs add up to whole ones", async () => {
  await MeshoptEncoder.ready;
  const random = draw(3);
  const vertices = 40;
  const box = { boxMin: [-1, 0, 2], boxMax: [1, 4, 3] };
  /** The parts of a frame, with steps as they are or told from others. */
  const told = (number, steps, base, fields = {}) => {
    const numbers = base === undefined ? steps : steps.map((step, k) => step - base[k]);
    const encoding = base === undefined ? Encoding.MESHOPT : Encoding.DELTA;
    return [0, 25].map((first, k) => {
      const count = k === 0 ? 25 : vertices - 25;
      const data = coded(numbers.slice(first * 4, (first + count) * 4));
      return part({ seq: 5n, part: k, parts: 2, number: BigInt(number), encoding, firstVertex: first, vertexCount: count, data, ...box, ...fields });
    });
  };
  const drawn = () => Uint16Array.from({ length: vertices * 4 }, (_, k) => (k % 4 === 3 ? 0 : random() * 65536));
  const whole = (steps) => {
    const data = new Uint8Array(steps.filter((_, k) => k % 4 < 3).buffer);
    const target = new Float32Array(vertices * 3);
    new Frame([part({ encoding: Encoding.U16, vertexCount: vertices, data, ...box })]).positionsInto(target);
    return target;
  };
  const read = (assembler, parts) => parts.map((one) => assembler.push(one)).at(-1);
  const shapes = [drawn(), drawn(), drawn()];
  const assembler = new Assembler();
  const frames = shapes.map((steps, k) => read(assembler, told(k + 1, steps, shapes[k - 1])));
  frames.forEach((frame, k) => {
    // One that is looked at late shows its own shape, not that of a later one.
    const target = new Float32Array(vertices * 3);
    frame.positionsInto(target);
    assert.deepEqual(target, whole(shapes[k]));
    assert.ok(!frame.isPartial);
  });
  // A part that did not compress stands for itself.
  const plain = told(4, shapes[0], shapes[2]);
  plain[0].encoding = Encoding.U16;
  plain[0].data = new Uint8Array(shapes[0].slice(0, 100).filter((_, k) => k % 4 < 3).buffer);
  const target = new Float32Array(vertices * 3);
  read(assembler, plain).positionsInto(target);
  assert.deepEqual(target, whole(shapes[0]));

  const refused = (parts, before = [told(1, shapes[0])]) => {
    const fresh = new Assembler();
    for (const frame of before) read(fresh, frame);
    assert.throws(() => read(fresh, parts), RangeError);
    // What comes next is told from nothing either, until a whole frame comes.
    assert.throws(() => read(fresh, told(3, shapes[2], shapes[1])), /not here/);
    assert.ok(read(fresh, told(4, shapes[0])));
  };
  const second = told(2, shapes[1], shapes[0]);
  refused(second, []);
  refused(told(3, shapes[1], shapes[0]));
  refused(told(2, shapes[1], shapes[0], { boxMax: [1, 4, 4] }));
  refused(told(2, shapes[1], shapes[0], { attribute: Attribute.NORMAL }));
  refused(told(2, shapes[1], shapes[0], { indices: [1] }));
  refused(told(2, shapes[1], shapes[0], { vertexCount: 24 }));
  refused(told(2, shapes[1], shapes[0], { encoding: Encoding.F32 }));
});

test("indices become runs where there are runs", () => {
  const { region } = regionOf([1, 3, 4, 5, 6, 7, 20, 21]);
  assert.deepEqual([...region.value.indices], [1, 20, 21]);
  assert.deepEqual(region.value.ranges.map(({ first, count }) => [first, count]), [[3, 5]]);
});
