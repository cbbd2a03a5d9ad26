/** What the first bytes of a picture say: its kind and how large it is, before anything is decoded. */

export interface PictureFacts {
  readonly kind: string;
  readonly width: number;
  readonly height: number;
}

/** Reads the header of a PNG, JPEG or WebP; nothing for other kinds and for headers that are cut off. */
export function pictureFacts(bytes: Uint8Array<ArrayBuffer>): PictureFacts | undefined {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
  try {
    if (view.getUint32(0) === 0x89504e47) return { kind: "image/png", width: view.getUint32(16), height: view.getUint32(20) };
    if (view.getUint16(0) === 0xffd8) return jpegFacts(view);
    if (view.getUint32(0) === 0x52494646 && view.getUint32(8) === 0x57454250) return webpFacts(view);
  } catch (error) {
    // Reading beyond the end: the file is cut off.
    if (!(error instanceof RangeError)) throw error;
  }
  return undefined;
}

/** The size stands in the frame header, after segments of any number and length. */
function jpegFacts(view: DataView): PictureFacts | undefined {
  for (let at = 2; ; ) {
    const marker = view.getUint16(at);
    if (marker >> 8 !== 0xff) return undefined;
    const kind = marker & 0xff;
    if (kind === 0xff) {
      at += 1;
      continue;
    }
    const isFrame = kind >= 0xc0 && kind <= 0xcf && kind !== 0xc4 && kind !== 0xc8 && kind !== 0xcc;
    if (isFrame) return { kind: "image/jpeg", height: view.getUint16(at + 5), width: view.getUint16(at + 7) };
    // The picture itself begins, or ends: there was no frame header.
    if (kind === 0xda || kind === 0xd9) return undefined;
    at += 2 + view.getUint16(at + 2);
  }
}

function webpFacts(view: DataView): PictureFacts | undefined {
  const kind = "image/webp";
  switch (view.getUint32(12)) {
    case 0x56503820:
      return { kind, width: view.getUint16(26, true) & 0x3fff, height: view.getUint16(28, true) & 0x3fff };
    case 0x5650384c: {
      const bits = view.getUint32(21, true);
      return { kind, width: (bits & 0x3fff) + 1, height: ((bits >> 14) & 0x3fff) + 1 };
    }
    case 0x56503858:
      return { kind, width: (view.getUint32(24, true) & 0xffffff) + 1, height: (view.getUint32(27, true) & 0xffffff) + 1 };
    default:
      return undefined;
  }
}
