/** How materials look: base colour, picture, transparency. What else a material says is for renderers of games. */

import { type GltfFile, type Item, isItem, itemAt, member, numbers, text, whole } from "./file.ts";

export type AlphaMode = "OPAQUE" | "MASK" | "BLEND";

/** A picture on a surface. */
export interface PictureUse {
  /** Index of the image in the document. */
  readonly image: number;
  /** glTF's numbers for wrapping along u and v, and for magnifying and minifying. */
  readonly wrap: readonly [number, number];
  readonly magnify: number;
  readonly minify: number;
  /** Which set of texture coordinates. */
  readonly set: number;
  /** u' = m0 u + m1 v + m2, v' = m3 u + m4 v + m5. */
  readonly transform: readonly number[];
}

/** What a surface looks like. */
export interface Look {
  readonly name: string;
  /** Linear red, green, blue and opacity. */
  readonly factor: readonly [number, number, number, number];
  readonly picture: PictureUse | undefined;
  readonly alpha: AlphaMode;
  readonly cutoff: number;
  readonly doubleSided: boolean;
  readonly unlit: boolean;
}

/** What the standard says of a primitive without a material. */
export const DEFAULT_LOOK: Look = {
  name: "",
  factor: [1, 1, 1, 1],
  picture: undefined,
  alpha: "OPAQUE",
  cutoff: 0.5,
  doubleSided: false,
  unlit: false,
};

const REPEAT = 10497;
const LINEAR = 9729;
const LINEAR_MIPMAP_LINEAR = 9987;

/** The look of a material of the document. */
export function lookOf(file: GltfFile, index: unknown): Look {
  const material = itemAt(file, "materials", index);
  if (material === undefined) return DEFAULT_LOOK;
  const extensions = member(material, "extensions");
  // Models of some years ago have their colours there.
  const glossy = extensions["KHR_materials_pbrSpecularGlossiness"];
  const older = isItem(glossy) && material["pbrMetallicRoughness"] === undefined;
  const base = older ? (glossy as Item) : member(material, "pbrMetallicRoughness");
  const factor = numbers(base[older ? "diffuseFactor" : "baseColorFactor"], 4) ?? [1, 1, 1, 1];
  const mode = material["alphaMode"];
  const cutoff = material["alphaCutoff"];
  return {
    name: text(material["name"]) ?? `material ${String(index)}`,
    factor: factor.map((x) => Math.min(1, Math.max(0, x))) as [number, number, number, number],
    picture: pictureOf(file, base[older ? "diffuseTexture" : "baseColorTexture"]),
    alpha: mode === "MASK" || mode === "BLEND" ? mode : "OPAQUE",
    cutoff: typeof cutoff === "number" && cutoff >= 0 ? cutoff : 0.5,
    doubleSided: material["doubleSided"] === true,
    unlit: isItem(extensions["KHR_materials_unlit"]),
  };
}

function pictureOf(file: GltfFile, use: unknown): PictureUse | undefined {
  if (!isItem(use)) return undefined;
  const texture = itemAt(file, "textures", use["index"]);
  if (texture === undefined) return undefined;
  const modern = member(member(texture, "extensions"), "EXT_texture_webp");
  const image = whole(modern["source"]) ?? whole(texture["source"]) ?? -1;
  const sampler = itemAt(file, "samplers", texture["sampler"]);
  const moved = member(member(use, "extensions"), "KHR_texture_transform");
  return {
    image,
    wrap: [whole(sampler?.["wrapS"]) ?? REPEAT, whole(sampler?.["wrapT"]) ?? REPEAT],
    magnify: whole(sampler?.["magFilter"]) ?? LINEAR,
    minify: whole(sampler?.["minFilter"]) ?? LINEAR_MIPMAP_LINEAR,
    set: whole(moved["texCoord"]) ?? whole(use["texCoord"]) ?? 0,
    transform: transformOf(moved),
  };
}

/** `KHR_texture_transform`: scale, then rotate, then offset. */
function transformOf(moved: Item): readonly number[] {
  const [ox, oy] = numbers(moved["offset"], 2) ?? [0, 0];
  const [sx, sy] = numbers(moved["scale"], 2) ?? [1, 1];
  const angle = typeof moved["rotation"] === "number" && Number.isFinite(moved["rotation"]) ? moved["rotation"] : 0;
  const [sin, cos] = [Math.sin(angle), Math.cos(angle)];
  return [cos * (sx as number), sin * (sy as number), ox as number, -sin * (sx as number), cos * (sy as number), oy as number];
}
