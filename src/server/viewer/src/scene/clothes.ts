/** What a model looks like, put on its surface: a geometry with texture coordinates and colours, and a material for each look. */

import * as THREE from "three";
import type { Appearance } from "../model/gltf/appearance.ts";
import type { Look } from "../model/gltf/looks.ts";
import { BEHIND_WIRE, takePaint } from "./paint.ts";

/** In the first of two passes a blended surface is solid where it is this opaque. */
const SOLID = 0.95;

/** An attribute of the bare surface, and its copy by drawn vertex where those are others. */
interface Followed {
  readonly from: THREE.BufferAttribute;
  readonly to: THREE.BufferAttribute;
}

export class Clothes {
  readonly geometry = new THREE.BufferGeometry();
  readonly materials: THREE.Material[] = [];
  private readonly followed = new Map<string, Followed>();

  constructor(
    private readonly appearance: Appearance,
    private readonly textures: readonly (THREE.Texture | undefined)[],
    bare: THREE.BufferGeometry,
    private readonly flatShading: boolean,
    private readonly borrowed = false,
  ) {
    const { indices, source, uv, colours, looks, runs } = appearance;
    for (const name of ["position", "normal", "paint"]) {
      const from = bare.getAttribute(name) as THREE.BufferAttribute;
      let to = from;
      if (source !== undefined) {
        const list = from.array.slice(0, 0).constructor as new (length: number) => Float32Array | Uint8Array;
        to = new THREE.BufferAttribute(new list(source.length * from.itemSize), from.itemSize, from.normalized);
        to.setUsage(THREE.DynamicDrawUsage);
        this.followed.set(name, { from, to });
      }
      this.geometry.setAttribute(name, to);
    }
    if (uv !== undefined) this.geometry.setAttribute("uv", new THREE.BufferAttribute(uv, 2));
    if (colours !== undefined) this.geometry.setAttribute("color", new THREE.BufferAttribute(colours, 4));
    this.geometry.setIndex(new THREE.BufferAttribute(indices, 1));
    const shared = { vertexColors: colours !== undefined, flatShading };
    const passes = looks.map((look, k) => {
      const made = materialsOf(look, this.textures[k], shared);
      const first = this.materials.length;
      this.materials.push(...made);
      return made.map((_, pass) => first + pass);
    });
    for (const { first, count, look } of runs) {
      for (const material of passes[look] ?? []) this.geometry.addGroup(first, count, material);
    }
    for (const name of this.followed.keys()) this.follow(name);
  }

  /** Brings drawn vertices to where their render vertices are. */
  follow(name: string): void {
    const pair = this.followed.get(name);
    const { source } = this.appearance;
    if (pair === undefined || source === undefined) return;
    const { array: from, itemSize } = pair.from;
    const { array: to } = pair.to;
    for (let v = 0; v < source.length; v++) {
      const at = (source[v] as number) * itemSize;
      for (let k = 0; k < itemSize; k++) to[v * itemSize + k] = from[at + k] as number;
    }
    pair.to.needsUpdate = true;
  }

  /** The same for another surface of the same vertices. Its pictures are these, and end with these. */
  lentTo(bare: THREE.BufferGeometry): Clothes {
    return new Clothes(this.appearance, this.textures, bare, this.flatShading, true);
  }

  dispose(): void {
    this.geometry.dispose();
    for (const material of this.materials) material.dispose();
    if (this.borrowed) return;
    for (const texture of this.textures) {
      texture?.dispose();
      (texture?.image as ImageBitmap | undefined)?.close();
    }
  }
}

/** One material, or two for what is blended: its solid places first, as other surfaces are, then the rest over what lies behind. */
function materialsOf(look: Look, map: THREE.Texture | undefined, shared: { vertexColors: boolean; flatShading: boolean }): THREE.Material[] {
  const [r, g, b, opacity] = look.factor;
  const given = {
    ...BEHIND_WIRE,
    color: new THREE.Color().setRGB(r, g, b),
    side: look.doubleSided ? THREE.DoubleSide : THREE.FrontSide,
    vertexColors: shared.vertexColors,
    ...(map === undefined ? {} : { map }),
  };
  const make = (more: THREE.MaterialParameters): THREE.Material =>
    takePaint(
      look.unlit
        ? new THREE.MeshBasicMaterial({ ...given, ...more })
        : new THREE.MeshLambertMaterial({ ...given, flatShading: shared.flatShading, ...more }),
    );
  if (look.alpha === "OPAQUE") return [make({})];
  // A cutoff of zero shows everything, which a threshold of zero does as well.
  if (look.alpha === "MASK") return [make({ opacity, alphaTest: look.cutoff })];
  return [make({ opacity, alphaTest: SOLID }), make({ opacity, transparent: true, depthWrite: false })];
}
