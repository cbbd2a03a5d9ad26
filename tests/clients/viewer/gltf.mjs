/** glTF files for the scenes: boxes with looks, a bar on two joints, clips good and bad, made of numbers and no file. */

import { deflateSync } from "node:zlib";

/** A PNG of `width` × `height` pixels; `colour` answers red, green, blue, opacity of a pixel. */
export function png(width, height, colour) {
  const rows = Buffer.alloc(height * (1 + width * 4));
  for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) rows.set(colour(x, y), y * (1 + width * 4) + 1 + x * 4);
  return pngOf(width, height, deflateSync(rows));
}

/** A PNG whose header tells of any size and whose data is this. */
export function pngOf(width, height, data) {
  const head = Buffer.alloc(13);
  head.writeUInt32BE(width, 0);
  head.writeUInt32BE(height, 4);
  head.set([8, 6, 0, 0, 0], 8);
  const signature = Buffer.from([0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a]);
  return Buffer.concat([signature, chunk("IHDR", head), chunk("IDAT", data), chunk("IEND", Buffer.alloc(0))]);
}

function chunk(kind, data) {
  const body = Buffer.concat([Buffer.from(kind), data]);
  const out = Buffer.alloc(body.length + 8);
  out.writeUInt32BE(data.length, 0);
  body.copy(out, 4);
  out.writeUInt32BE(crc(body), body.length + 4);
  return out;
}

function crc(bytes) {
  let sum = 0xffffffff;
  for (const byte of bytes) {
    sum ^= byte;
    for (let k = 0; k < 8; k++) sum = sum & 1 ? (sum >>> 1) ^ 0xedb88320 : sum >>> 1;
  }
  return (sum ^ 0xffffffff) >>> 0;
}

/** A box of 24 vertices around the origin, each face with its own corners and the whole square of texture coordinates. */
export function box(half) {
  const positions = [];
  const uv = [];
  const indices = [];
  for (const axis of [0, 1, 2]) {
    for (const side of [-1, 1]) {
      const first = positions.length / 3;
      const [across, up] = [(axis + 1) % 3, (axis + 2) % 3];
      for (const [u, v] of [[0, 0], [1, 0], [1, 1], [0, 1]]) {
        const p = [0, 0, 0];
        p[axis] = side * half[axis];
        p[across] = (u * 2 - 1) * half[across];
        p[up] = (v * 2 - 1) * half[up];
        positions.push(...p);
        // The upper left of the picture is 0, 0.
        uv.push(u, 1 - v);
      }
      const around = side > 0 ? [0, 1, 2, 0, 2, 3] : [0, 2, 1, 0, 3, 2];
      indices.push(...around.map((k) => first + k));
    }
  }
  return { positions, uv, indices };
}

/** Puts accessors and pictures into one buffer. */
export class Writer {
  #parts = [];
  #length = 0;
  views = [];
  accessors = [];

  view(bytes) {
    this.#parts.push(bytes, Buffer.alloc((4 - (bytes.length % 4)) % 4));
    this.views.push({ buffer: 0, byteOffset: this.#length, byteLength: bytes.length });
    this.#length += bytes.length + ((4 - (bytes.length % 4)) % 4);
    return this.views.length - 1;
  }

  accessor(numbers, type, componentType = 5126, more = {}) {
    const List = { 5126: Float32Array, 5123: Uint16Array, 5121: Uint8Array }[componentType];
    const lanes = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4, MAT4: 16 }[type];
    const list = List.from(numbers);
    this.accessors.push({ bufferView: this.view(Buffer.from(list.buffer)), componentType, count: list.length / lanes, type, ...more });
    return this.accessors.length - 1;
  }

  positions(numbers) {
    const lowest = (axis, pick) => pick(...numbers.filter((_, k) => k % 3 === axis));
    const range = (pick) => [0, 1, 2].map((axis) => Math.fround(lowest(axis, pick)));
    return this.accessor(numbers, "VEC3", 5126, { min: range(Math.min), max: range(Math.max) });
  }

  /** The file, as the page is given it. */
  glb(name, rest) {
    const { views: bufferViews, accessors } = this;
    const document = { asset: { version: "2.0" }, scene: 0, bufferViews, accessors, buffers: [{ byteLength: this.#length }], ...rest };
    const text = Buffer.from(JSON.stringify(document));
    const json = Buffer.concat([text, Buffer.alloc((4 - (text.length % 4)) % 4, 0x20)]);
    const head = (...words) => Buffer.from(Uint32Array.from(words).buffer);
    const buffer = Buffer.concat([
      head(0x46546c67, 2, 28 + json.length + this.#length, json.length, 0x4e4f534a),
      json,
      head(this.#length, 0x004e4942),
      ...this.#parts,
    ]);
    return { name, mimeType: "model/gltf-binary", buffer };
  }
}

const QUADRANTS = [
  [220, 30, 30, 255],
  [30, 190, 30, 255],
  [30, 60, 230, 255],
  [230, 210, 20, 255],
];

/** Boxes in a row along x, each with a look of its own. */
export function lookingBoxes() {
  const writer = new Writer();
  const { positions, uv, indices } = box([0.9, 0.9, 0.9]);
  const shape = { POSITION: writer.positions(positions), TEXCOORD_0: writer.accessor(uv, "VEC2") };
  const corners = writer.accessor(indices, "SCALAR", 5123);
  // Half of the texture coordinates, for the other half of the picture.
  const shifted = { ...shape, TEXCOORD_1: writer.accessor(uv.map((x, k) => (k % 2 === 0 ? x * 0.5 + 0.5 : x)), "VEC2") };
  const painted = { ...shape, COLOR_0: writer.accessor(positions.flatMap(() => []).concat(...Array.from({ length: 24 }, () => [0, 255, 255, 255])), "VEC4", 5121, { normalized: true }) };
  const quadrants = writer.view(png(2, 2, (x, y) => QUADRANTS[y * 2 + x]));
  const stencil = writer.view(png(2, 2, (x) => (x === 0 ? [255, 0, 255, 0] : [255, 0, 255, 255])));
  const broken = writer.view(Buffer.concat([png(4, 4, () => [9, 9, 9, 255]).subarray(0, 40), Buffer.from("and then nothing")]));
  const huge = writer.view(pngOf(16384, 16384, deflateSync(Buffer.alloc(64))));
  const texture = (index, more = {}) => ({ pbrMetallicRoughness: { baseColorTexture: { index, ...more } } });
  const factor = (...baseColorFactor) => ({ pbrMetallicRoughness: { baseColorFactor } });
  const materials = [
    { name: "quadrants", ...texture(0) },
    { name: "right half", ...texture(0, { texCoord: 1 }) },
    { name: "painted" },
    { name: "stencil", alphaMode: "MASK", ...texture(1) },
    { name: "absent", pbrMetallicRoughness: { baseColorFactor: [1, 0.1, 0.1, 1], baseColorTexture: { index: 2 } } },
    { name: "broken", pbrMetallicRoughness: { baseColorFactor: [0.1, 1, 0.1, 1], baseColorTexture: { index: 3 } } },
    { name: "huge", pbrMetallicRoughness: { baseColorFactor: [0.1, 0.1, 1, 1], baseColorTexture: { index: 4 } } },
    { name: "glass", alphaMode: "BLEND", ...factor(1, 1, 0, 0.4) },
  ];
  const shapes = [shape, shifted, painted, shape, shape, shape, shape, shape];
  return writer.glb("boxes.glb", {
    scenes: [{ nodes: materials.map((_, k) => k) }],
    nodes: materials.map((_, k) => ({ mesh: k, translation: [(k % 4) * 3, k < 4 ? 3 : 0, 0] })),
    meshes: materials.map((_, material) => ({ primitives: [{ attributes: shapes[material], indices: corners, material }] })),
    materials,
    samplers: [{ magFilter: 9728, minFilter: 9728, wrapS: 33071, wrapT: 33071 }],
    textures: [0, 1, 2, 3, 4].map((source) => ({ source, sampler: 0 })),
    images: [
      { bufferView: quadrants, mimeType: "image/png" },
      { bufferView: stencil, mimeType: "image/png" },
      { uri: "nowhere.png" },
      { bufferView: broken, mimeType: "image/png" },
      { bufferView: huge, mimeType: "image/png" },
    ],
  });
}

/** A bar of slices along y that hangs on two joints, with clips that play and clips that cannot. */
export function dancingBar() {
  const writer = new Writer();
  const [slices, height] = [17, 4];
  const positions = [];
  const weights = [];
  const indices = [];
  for (let k = 0; k < slices; k++) {
    const share = k / (slices - 1);
    for (const [x, z] of [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) {
      positions.push(x, share * height, z);
      weights.push(1 - share, share, 0, 0);
    }
    if (k === 0) continue;
    for (let side = 0; side < 4; side++) {
      const [a, b] = [(k - 1) * 4 + side, (k - 1) * 4 + ((side + 1) % 4)];
      indices.push(a, a + 4, b, b, a + 4, b + 4);
    }
  }
  const top = (slices - 1) * 4;
  indices.push(0, 1, 2, 0, 2, 3, top, top + 2, top + 1, top, top + 3, top + 2);
  const attributes = {
    POSITION: writer.positions(positions),
    JOINTS_0: writer.accessor(weights.map((_, k) => (k % 4 === 1 ? 1 : 0)), "VEC4", 5121),
    WEIGHTS_0: writer.accessor(weights, "VEC4"),
  };
  const primitive = { attributes, indices: writer.accessor(indices, "SCALAR", 5123) };
  const still = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
  const inverse = writer.accessor([...still, ...still.with(13, -height)], "MAT4");
  const times = (...list) => writer.accessor(list, "SCALAR", 5126, { min: [list[0]], max: [list.at(-1)] });
  const moves = (list) => writer.accessor(list, "VEC3");
  const clip = (name, input, output, interpolation = "LINEAR") => ({
    name,
    samplers: [{ input, output, interpolation }],
    channels: [{ sampler: 0, target: { node: 2, path: "translation" } }],
  });
  const two = times(0, 2);
  return writer.glb("bar.glb", {
    scenes: [{ nodes: [0, 1] }],
    nodes: [{ mesh: 0, skin: 0, name: "bar" }, { children: [2], name: "root" }, { translation: [0, height, 0], name: "tip" }],
    meshes: [{ primitives: [primitive] }],
    skins: [{ joints: [1, 2], inverseBindMatrices: inverse }],
    animations: [
      clip("across", two, moves([0, height, 0, 2, height, 0])),
      clip("steps", two, moves([0, height, 0, 0, height + 1, 0]), "STEP"),
      clip("curve", two, moves([0, 0, 0, 0, height, 0, 1, 0, 0, 0, 0, 0, 2, height, 0, 0, 0, 0]), "CUBICSPLINE"),
      clip("broken", writer.accessor([0, Number.NaN], "SCALAR"), moves([0, height, 0, 9, height, 0])),
      { name: "empty", samplers: [], channels: [] },
    ],
  });
}
