/** Pictures of a model, decoded by the browser and bounded before they are: what a header says is not believed to be small. */

import * as THREE from "three";
import { type GltfFile, bytesOf, itemAt, text, viewBytes } from "../model/gltf/file.ts";
import type { Look, PictureUse } from "../model/gltf/looks.ts";
import { type PictureFacts, pictureFacts } from "../model/pictures.ts";

/** Pixels of one picture that are decoded: 8192 × 8192. */
const MOST_DECODED = 2 ** 26;
/** Pixels of all pictures of a model that are kept, and the longest side of one. */
const MOST_KEPT = 2 ** 27;
const LONGEST_SIDE = 4096;
const SHORTEST_LIMIT = 256;

const WRAPS: Record<number, THREE.Wrapping> = { 33071: THREE.ClampToEdgeWrapping, 33648: THREE.MirroredRepeatWrapping, 10497: THREE.RepeatWrapping };
const FILTERS: Record<number, THREE.TextureFilter> = {
  9728: THREE.NearestFilter,
  9729: THREE.LinearFilter,
  9984: THREE.NearestMipmapNearestFilter,
  9985: THREE.LinearMipmapNearestFilter,
  9986: THREE.NearestMipmapLinearFilter,
  9987: THREE.LinearMipmapLinearFilter,
};

/** The textures of looks, in their order, and what could not be drawn. */
export interface Textures {
  readonly of: readonly (THREE.Texture | undefined)[];
  readonly faults: readonly string[];
}

interface Source {
  readonly bytes: Uint8Array<ArrayBuffer>;
  readonly facts: PictureFacts;
}

/** Decodes the pictures of these looks. Failed ones are left out, and listed. */
export async function loadTextures(file: GltfFile, looks: readonly Look[], longest: number): Promise<Textures> {
  const faults: string[] = [];
  const sources = new Map<number, Source>();
  for (const { picture, name } of looks) {
    if (picture === undefined || sources.has(picture.image)) continue;
    const found = await sourceOf(file, picture.image);
    if (typeof found === "string") faults.push(`${name}: ${found}; its plain colour is shown`);
    else sources.set(picture.image, found);
  }
  const side = sideFor([...sources.values()], Math.min(LONGEST_SIDE, longest));
  const bitmaps = new Map<number, ImageBitmap>();
  for (const [image, source] of sources) {
    const bitmap = await decoded(source, side);
    if (bitmap === undefined) faults.push(`image ${image} is damaged; the plain colour of its material is shown`);
    else bitmaps.set(image, bitmap);
  }
  const of = looks.map(({ picture }) => {
    const bitmap = picture && bitmaps.get(picture.image);
    return picture === undefined || bitmap === undefined ? undefined : textureOf(bitmap, picture);
  });
  return { of, faults };
}

/** The bytes of an image, or why they are not drawn. */
async function sourceOf(file: GltfFile, index: number): Promise<Source | string> {
  const image = itemAt(file, "images", index);
  if (image === undefined) return "its picture is of a kind that this page does not read";
  const uri = text(image["uri"]);
  const bytes = uri === undefined ? viewBytes(file, image["bufferView"]) : await bytesOf(uri, file.companions);
  const name = uri === undefined || uri.startsWith("data:") ? `image ${index}` : `“${uri.slice(0, 80)}”`;
  if (bytes === undefined) return `${name} is missing`;
  const facts = pictureFacts(bytes);
  if (facts === undefined) return `${name} is not a PNG, JPEG or WebP`;
  const { width, height } = facts;
  if (width === 0 || height === 0 || width * height > MOST_DECODED) {
    const [w, h] = [width.toLocaleString("en"), height.toLocaleString("en")];
    return `${name} has ${w} × ${h} pixels, at most ${MOST_DECODED.toLocaleString("en")} in all are drawn`;
  }
  return { bytes, facts };
}

/** The longest side with which all pictures together are not too many pixels. */
function sideFor(sources: readonly Source[], longest: number): number {
  for (let side = longest; ; side /= 2) {
    const pixels = sources.reduce((sum, { facts }) => sum + area(facts, side), 0);
    if (pixels <= MOST_KEPT || side <= SHORTEST_LIMIT) return side;
  }
}

function area({ width, height }: PictureFacts, side: number): number {
  const share = Math.min(1, side / Math.max(width, height));
  return width * share * height * share;
}

async function decoded({ bytes, facts }: Source, side: number): Promise<ImageBitmap | undefined> {
  const { width, height, kind } = facts;
  const share = Math.min(1, side / Math.max(width, height));
  const resize: ImageBitmapOptions =
    share === 1
      ? {}
      : { resizeWidth: Math.max(1, Math.round(width * share)), resizeHeight: Math.max(1, Math.round(height * share)), resizeQuality: "medium" };
  try {
    return await createImageBitmap(new Blob([bytes], { type: kind }), { colorSpaceConversion: "none", premultiplyAlpha: "none", ...resize });
  } catch {
    return undefined;
  }
}

function textureOf(bitmap: ImageBitmap, { wrap, magnify, minify }: PictureUse): THREE.Texture {
  const texture = new THREE.Texture(bitmap);
  texture.flipY = false;
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.wrapS = WRAPS[wrap[0]] ?? THREE.RepeatWrapping;
  texture.wrapT = WRAPS[wrap[1]] ?? THREE.RepeatWrapping;
  texture.magFilter = magnify === 9728 ? THREE.NearestFilter : THREE.LinearFilter;
  texture.minFilter = (FILTERS[minify] ?? THREE.LinearMipmapLinearFilter) as THREE.MinificationTextureFilter;
  texture.generateMipmaps = minify >= 9984;
  texture.anisotropy = 4;
  texture.needsUpdate = true;
  return texture;
}
