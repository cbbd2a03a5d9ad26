/** 4 × 4 matrices in lists of 16 numbers, column after column, as glTF has them. */

export type Numbers = Float32Array | Float64Array | readonly number[];

export const IDENTITY: readonly number[] = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

/** out[at] = a[ai] · b[bi], for matrices with the last row 0 0 0 1. */
export function multiply(out: Float64Array, at: number, a: Numbers, ai: number, b: Numbers, bi: number): void {
  for (let column = 0; column < 4; column++) {
    const x = b[bi + column * 4] as number;
    const y = b[bi + column * 4 + 1] as number;
    const z = b[bi + column * 4 + 2] as number;
    for (let row = 0; row < 3; row++) {
      const sum = (a[ai + row] as number) * x + (a[ai + 4 + row] as number) * y + (a[ai + 8 + row] as number) * z;
      out[at + column * 4 + row] = column === 3 ? sum + (a[ai + 12 + row] as number) : sum;
    }
    out[at + column * 4 + 3] = column === 3 ? 1 : 0;
  }
}

/** out[at] = the matrix of a translation, a rotation (x, y, z, w; of any length) and a scale. */
export function compose(out: Float64Array, at: number, place: Numbers, turn: Numbers, size: Numbers): void {
  const [qx, qy, qz, qw] = [turn[0] as number, turn[1] as number, turn[2] as number, turn[3] as number];
  const two = 2 / (qx * qx + qy * qy + qz * qz + qw * qw || 1);
  const [sx, sy, sz] = [size[0] as number, size[1] as number, size[2] as number];
  out[at] = (1 - two * (qy * qy + qz * qz)) * sx;
  out[at + 1] = two * (qx * qy + qz * qw) * sx;
  out[at + 2] = two * (qx * qz - qy * qw) * sx;
  out[at + 3] = 0;
  out[at + 4] = two * (qx * qy - qz * qw) * sy;
  out[at + 5] = (1 - two * (qx * qx + qz * qz)) * sy;
  out[at + 6] = two * (qy * qz + qx * qw) * sy;
  out[at + 7] = 0;
  out[at + 8] = two * (qx * qz + qy * qw) * sz;
  out[at + 9] = two * (qy * qz - qx * qw) * sz;
  out[at + 10] = (1 - two * (qx * qx + qy * qy)) * sz;
  out[at + 11] = 0;
  out[at + 12] = place[0] as number;
  out[at + 13] = place[1] as number;
  out[at + 14] = place[2] as number;
  out[at + 15] = 1;
}

/** Between two rotations, the shorter way round; `share` from 0 to 1. */
export function slerp(a: Numbers, ai: number, b: Numbers, bi: number, share: number, out: number[]): void {
  let dot = 0;
  for (let k = 0; k < 4; k++) dot += (a[ai + k] as number) * (b[bi + k] as number);
  const side = dot < 0 ? -1 : 1;
  const angle = Math.acos(Math.min(1, Math.abs(dot)));
  const sine = Math.sin(angle);
  // Nearly the same: a straight line is as good, and divides by nothing.
  const near = sine < 1e-6;
  const first = near ? 1 - share : Math.sin((1 - share) * angle) / sine;
  const second = (near ? share : Math.sin(share * angle) / sine) * side;
  for (let k = 0; k < 4; k++) out[k] = (a[ai + k] as number) * first + (b[bi + k] as number) * second;
}
