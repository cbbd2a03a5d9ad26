/**
 * meshoptimizer's vertex codec, versions 0 and 1, for vertices of four 16-bit numbers: how MESHOPT and DELTA frames are packed. It is
 * read here in plain script, so that pages whose policy allows no WebAssembly read such frames too, and at once. The format is that of
 * meshoptimizer's `decodeVertexBuffer` (EXT_meshopt_compression and KHR_meshopt_compression describe it).
 */

/** Bytes of a vertex. */
const STRIDE = 8;
/** Vertices of a block. */
const BLOCK = 256;
/** Vertices of a group, whose numbers are packed alike. */
const GROUP = 16;
/** Bits of a number by the two bits of its group: of version 0, and of version 1 by the mode of the plane. */
const BITS_V0 = [0, 2, 4, 8];
const BITS_V1 = [
  [0, 1, 2, 4],
  [1, 2, 4, 8],
];

/**
 * Reads `count` vertices of four numbers into `out`.
 *
 * @throws RangeError for bytes that are no such code.
 */
export function decodeSteps(source: Uint8Array, count: number, out: Uint16Array): void {
  const version = (source[0] ?? 0) - 0xa0;
  if (version !== 0 && version !== 1) throw broken("begins with an unknown version");
  // Behind the blocks: what differences of the first vertex are told from, and in version 1 how each pair of numbers is told.
  const tail = version === 0 ? STRIDE : STRIDE + STRIDE / 4;
  const end = source.length - Math.max(tail, version === 0 ? 32 : 24);
  if (end < 1) throw broken("is too short");
  const last = source.slice(source.length - tail, source.length - tail + STRIDE);
  const planes = new Uint8Array(STRIDE * BLOCK);
  let at = 1;
  for (let first = 0; first < count; first += BLOCK) {
    const vertices = Math.min(BLOCK, count - first);
    const controls = at;
    if (version === 1) at += STRIDE / 4;
    for (let plane = 0; plane < STRIDE; plane++) {
      const to = plane * BLOCK;
      const mode = version === 0 ? 0 : ((source[controls + (plane >> 2)] ?? 0) >> ((plane & 3) << 1)) & 3;
      if (mode === 2) {
        planes.fill(0, to, to + vertices);
      } else if (mode === 3) {
        if (at + vertices > end) throw broken("ends early");
        planes.set(source.subarray(at, at + vertices), to);
        at += vertices;
      } else {
        at = readPlane(source, at, end, vertices, version === 0 ? BITS_V0 : (BITS_V1[mode] as number[]), planes, to);
      }
    }
    for (let pair = 0; pair < 2; pair++) {
      const channel = version === 0 ? 0 : (source[source.length - 2 + pair] as number);
      writePair(planes, pair * 4, vertices, channel, last, out, first * 4 + pair * 2);
    }
  }
  if (at > end) throw broken("ends early");
  if (at < end) throw broken(`has ${end - at} bytes more than its vertices need`);
}

/** Reads one byte of each vertex of a block; answers where the next begins. */
function readPlane(source: Uint8Array, from: number, end: number, vertices: number, bits: number[], planes: Uint8Array, to: number): number {
  const groups = Math.ceil(vertices / GROUP);
  const heads = from;
  let at = heads + Math.ceil(groups / 4);
  for (let group = 0; group < groups; group++, to += GROUP) {
    const width = bits[((source[heads + (group >> 2)] ?? 0) >> ((group & 3) << 1)) & 3] as number;
    if (width === 0) {
      planes.fill(0, to, to + GROUP);
      continue;
    }
    if (at + width * 2 > end) throw broken("ends early");
    if (width === 8) {
      for (let k = 0; k < GROUP; k++) planes[to + k] = source[at + k] as number;
      at += GROUP;
      continue;
    }
    // Numbers of few bits; the highest stands for a whole byte behind them.
    const whole = (1 << width) - 1;
    let more = at + width * 2;
    for (let k = 0; k < GROUP; at++) {
      const packed = source[at] as number;
      for (let bit = 0; bit < 8; bit += width, k++) {
        // From the lowest bit on where they are single, else from the highest.
        const small = (packed >> (width === 1 ? bit : 8 - width - bit)) & whole;
        planes[to + k] = small === whole ? (source[more++] as number) : small;
      }
    }
    at = more;
  }
  // Bytes beyond the end were read as nothing.
  if (at > end) throw broken("ends early");
  return at;
}

/** Two numbers of each vertex of a block, from four planes. */
function writePair(planes: Uint8Array, plane: number, vertices: number, channel: number, last: Uint8Array, out: Uint16Array, to: number): void {
  let a = plane * BLOCK;
  let [b, c, d] = [a + BLOCK, a + 2 * BLOCK, a + 3 * BLOCK];
  let low = (last[plane] as number) | ((last[plane + 1] as number) << 8);
  let high = (last[plane + 2] as number) | ((last[plane + 3] as number) << 8);
  const kind = channel & 3;
  const turn = channel >> 4;
  for (let k = 0; k < vertices; k++, a++, b++, c++, d++, to += 4) {
    const [p, q, r, s] = [planes[a] as number, planes[b] as number, planes[c] as number, planes[d] as number];
    if (kind === 0) {
      low = ((low + unzigzag(p)) & 0xff) | (((low >> 8) + unzigzag(q)) << 8);
      high = ((high + unzigzag(r)) & 0xff) | (((high >> 8) + unzigzag(s)) << 8);
    } else if (kind === 1) {
      low += unzigzag(p | (q << 8));
      high += unzigzag(r | (s << 8));
    } else if (kind === 2) {
      const told = p | (q << 8) | (r << 16) | (s << 24);
      const turned = (told >>> turn) | (told << (32 - turn));
      low ^= turned & 0xffff;
      high ^= turned >>> 16;
    } else {
      throw broken("codes its numbers in an unknown way");
    }
    low &= 0xffff;
    high &= 0xffff;
    out[to] = low;
    out[to + 1] = high;
  }
  last[plane] = low & 0xff;
  last[plane + 1] = low >> 8;
  last[plane + 2] = high & 0xff;
  last[plane + 3] = high >> 8;
}

function unzigzag(value: number): number {
  return (value >>> 1) ^ -(value & 1);
}

function broken(how: string): RangeError {
  return new RangeError(`the code of a part of a frame ${how}`);
}
