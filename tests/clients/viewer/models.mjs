/** Models that the scenes open: files of the data folder, and generated ones of any size. */

import { existsSync } from "node:fs";

/** The folder with model files. */
export const DATA = process.env.PLIANT_DATA ?? new URL("../../../../shared/data", import.meta.url).pathname;

/** A file of the data folder, when it is there. */
export function dataFile(name) {
  const path = `${DATA}/${name}`;
  return existsSync(path) ? path : undefined;
}

/** A closed finger with grooves, lying along y, of about `vertices` vertices, as binary PLY. */
export function finger(vertices) {
  const around = Math.round(Math.sqrt(vertices / 3));
  const along = Math.floor((vertices - 2) / around);
  const count = around * along + 2;
  const positions = new Float32Array(count * 3);
  for (let j = 0; j < along; j++) {
    const t = (j + 0.5) / along;
    const radius = 0.5 * Math.sin(Math.PI * t) ** 0.35 * (1 + 0.05 * Math.cos(40 * t));
    for (let i = 0; i < around; i++) {
      const angle = (2 * Math.PI * i) / around;
      positions.set([radius * Math.cos(angle), 4 * t, radius * Math.sin(angle)], (j * around + i) * 3);
    }
  }
  positions.set([0, 0, 0, 0, 4, 0], around * along * 3);
  const triangles = [];
  const [bottom, top] = [around * along, around * along + 1];
  for (let i = 0; i < around; i++) {
    const next = (i + 1) % around;
    triangles.push(bottom, i, next, top, (along - 1) * around + next, (along - 1) * around + i);
    for (let j = 0; j + 1 < along; j++) {
      const [a, b] = [j * around + i, j * around + next];
      triangles.push(a, a + around, b, b, a + around, b + around);
    }
  }
  const faces = triangles.length / 3;
  const head = `ply\nformat binary_little_endian 1.0\nelement vertex ${count}\nproperty float x\nproperty float y\nproperty float z\nelement face ${faces}\nproperty list uchar uint vertex_indices\nend_header\n`;
  const body = Buffer.alloc(faces * 13);
  for (let f = 0; f < faces; f++) {
    body.writeUInt8(3, f * 13);
    for (let c = 0; c < 3; c++) body.writeUInt32LE(triangles[f * 3 + c], f * 13 + 1 + c * 4);
  }
  const buffer = Buffer.concat([Buffer.from(head), Buffer.from(positions.buffer), body]);
  return { name: `finger-${count}.ply`, mimeType: "application/octet-stream", buffer };
}

/** The figure's body alone: a page's session solves hull and coarser levels of detail too, `pliant animate` leaves them out. */
export function bodyAlone(glb) {
  const length = glb.readUInt32LE(12);
  const document = JSON.parse(glb.subarray(20, 20 + length));
  const isLeftOut = (node) => ["hull", "lod1", "lod2"].includes(document.nodes[node].name);
  document.scenes[0].nodes = document.scenes[0].nodes.filter((node) => !isLeftOut(node));
  const text = Buffer.from(JSON.stringify(document));
  const padded = Buffer.concat([text, Buffer.alloc(-text.length & 3, " ")]);
  const head = Buffer.from(glb.subarray(0, 20));
  head.writeUInt32LE(glb.length - length + padded.length, 8);
  head.writeUInt32LE(padded.length, 12);
  return Buffer.concat([head, padded, glb.subarray(20 + length)]);
}
