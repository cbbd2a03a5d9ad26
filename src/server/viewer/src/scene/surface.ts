/**
 * The drawn surface: one geometry over all render vertices, whose position array is the one that frames are decoded
 * into. Normals and stretch follow at a pace that leaves time to paint.
 */

import * as THREE from "three";
import { type Smoothing, smoothingOf, updateNormals } from "../model/normals.ts";
import type { SurfaceReport } from "../model/report.ts";
import { StretchMeter } from "../model/stretch.ts";
import type { Topology } from "pliant-client";
import type { Appearance } from "../model/gltf/appearance.ts";
import { Clothes } from "./clothes.ts";
import { BEHIND_WIRE, takePaint } from "./paint.ts";

/** Milliseconds of a painted frame that shading may take while dragging. */
const SHADING_MS = 5;
/** Below this a model without normals is drawn with flat triangles, as a modeller would expect of a box. */
const FEW_TRIANGLES = 2000;

export class Surface {
  readonly object = new THREE.Group();
  /** Render vertices and their triangles, whatever is drawn of them. */
  readonly geometry = new THREE.BufferGeometry();
  /** x, y, z per render vertex; frames are decoded into it. */
  readonly positions: Float32Array<ArrayBuffer>;
  readonly stretch: Float32Array<ArrayBuffer>;
  private readonly normals: THREE.BufferAttribute;
  private readonly paint: THREE.BufferAttribute;
  private readonly smoothing: Smoothing;
  private readonly marks: THREE.Mesh<THREE.BufferGeometry, THREE.MeshBasicMaterial[]>;
  private readonly wire: THREE.LineSegments<THREE.BufferGeometry, THREE.LineBasicMaterial>;
  private readonly mesh: THREE.Mesh<THREE.BufferGeometry, THREE.Material | THREE.Material[]>;
  private readonly clay: THREE.MeshLambertMaterial;
  private readonly flat: boolean;
  private clothes: Clothes | undefined;
  private meter: StretchMeter | undefined;
  private shadingMs = 0;
  private waited = 0;
  /** Whether normals lag behind positions. */
  private stale = false;

  constructor(
    readonly topology: Topology,
    readonly report: SurfaceReport,
    private readonly rest: Float32Array,
  ) {
    const vertices = topology.positions.length / 3;
    this.positions = topology.positions.slice();
    this.stretch = new Float32Array(vertices);
    const { geometry } = this;
    geometry.setAttribute("position", dynamic(new THREE.BufferAttribute(this.positions, 3)));
    this.normals = dynamic(new THREE.BufferAttribute(topology.normals?.slice() ?? new Float32Array(vertices * 3), 3));
    geometry.setAttribute("normal", this.normals);
    this.paint = dynamic(new THREE.BufferAttribute(new Uint8Array(vertices * 4), 4, true));
    geometry.setAttribute("paint", this.paint);
    geometry.setIndex(new THREE.BufferAttribute(topology.indices, 1));
    this.smoothing = smoothingOf(topology, report);
    this.flat = topology.normals === undefined && topology.indices.length < FEW_TRIANGLES * 3;
    this.clay = clay(this.flat);
    this.mesh = new THREE.Mesh<THREE.BufferGeometry, THREE.Material | THREE.Material[]>(geometry, this.clay);
    // Its box changes with every frame; testing it against the view would cost more than drawing.
    this.mesh.frustumCulled = false;
    this.wire = new THREE.LineSegments(
      new THREE.BufferGeometry(),
      new THREE.LineBasicMaterial({ transparent: true, opacity: 0.35, depthWrite: false }),
    );
    this.wire.frustumCulled = false;
    this.wire.visible = false;
    this.marks = new THREE.Mesh(new THREE.BufferGeometry(), MARKS);
    this.marks.frustumCulled = false;
    this.marks.visible = false;
    const behind = new THREE.Mesh(this.marks.geometry, MARKS_BEHIND);
    behind.frustumCulled = false;
    behind.renderOrder = 1;
    this.marks.add(behind);
    this.object.add(this.mesh, this.wire, this.marks);
    if (topology.normals === undefined) this.shade(true);
  }

  /** The colours that paint is mixed over. */
  setTheme(clayColour: number, wireColour: number): void {
    this.clay.color.setHex(clayColour);
    this.wire.material.color.setHex(wireColour);
  }

  /** Takes on what the model looks like. */
  dress(appearance: Appearance, textures: readonly (THREE.Texture | undefined)[]): void {
    this.clothes?.dispose();
    this.clothes = new Clothes(appearance, textures, this.geometry, this.flat);
  }

  /** Takes on what another surface of the same vertices looks like. */
  dressLike(other: Surface): void {
    this.clothes?.dispose();
    this.clothes = other.clothes?.lentTo(this.geometry);
  }

  /** Whether it is known what the model looks like. */
  get isDressed(): boolean {
    return this.clothes !== undefined;
  }

  /** Shows the model as it looks, or as clay. */
  showLooks(wanted: boolean): void {
    const clothes = wanted ? this.clothes : undefined;
    this.mesh.geometry = clothes?.geometry ?? this.geometry;
    this.mesh.material = clothes?.materials ?? this.clay;
  }

  setWire(visible: boolean): void {
    if (visible && this.wire.geometry.index === null) {
      this.wire.geometry.setAttribute("position", this.geometry.getAttribute("position"));
      this.wire.geometry.setIndex(new THREE.BufferAttribute(edges(this.topology.indices), 1));
    }
    this.wire.visible = visible;
  }

  /** Marks triangles that cross others: those that do so newly, and those that did in the rest pose. */
  mark(now: readonly number[], atRest: readonly number[]): void {
    const { indices } = this.topology;
    const corners = [...now, ...atRest].flatMap((t) => [...indices.subarray(3 * t, 3 * t + 3)]);
    const { geometry } = this.marks;
    geometry.setAttribute("position", this.geometry.getAttribute("position"));
    geometry.setIndex(new THREE.BufferAttribute(Uint32Array.from(corners), 1));
    geometry.clearGroups();
    geometry.addGroup(0, 3 * now.length, 0);
    geometry.addGroup(3 * now.length, 3 * atRest.length, 1);
    this.marks.visible = corners.length > 0;
  }

  /** The positions changed. While `moving`, shading may lag. */
  moved(moving: boolean): void {
    this.geometry.getAttribute("position").needsUpdate = true;
    this.clothes?.follow("position");
    this.waited += 1;
    // On average shading may take its share of a frame, no more.
    if (!moving || this.waited * SHADING_MS >= this.shadingMs) this.shade(false);
    else this.stale = true;
  }

  /** Brings shading up to date. */
  settle(): void {
    if (this.stale) this.shade(false);
  }

  /** Measures the change of edge lengths into `stretch`. */
  measureStretch(): void {
    this.meter ??= new StretchMeter(this.rest, this.topology.indices, this.report);
    this.meter.measure(this.positions, this.stretch);
  }

  /** Lets `write` fill red, green, blue and strength of every render vertex. */
  repaint(write: (colours: Uint8Array) => void): void {
    write(this.paint.array as Uint8Array);
    this.paint.needsUpdate = true;
    this.clothes?.follow("paint");
  }

  /** The direction in which the surface faces at a render vertex. */
  normalOf(vertex: number): THREE.Vector3 {
    return new THREE.Vector3().fromArray(this.normals.array, vertex * 3);
  }

  /** The ball around the current shape. */
  bounds(): THREE.Sphere {
    const box = new THREE.Box3().setFromArray(this.positions);
    return box.getBoundingSphere(new THREE.Sphere());
  }

  dispose(): void {
    this.geometry.dispose();
    this.clay.dispose();
    this.clothes?.dispose();
    this.marks.geometry.dispose();
    this.wire.geometry.dispose();
    this.wire.material.dispose();
  }

  private shade(first: boolean): void {
    const begun = performance.now();
    updateNormals(this.positions, this.topology.indices, this.smoothing, this.normals.array as Float32Array);
    this.normals.needsUpdate = true;
    this.clothes?.follow("normal");
    this.stale = false;
    this.waited = 0;
    const took = performance.now() - begun;
    this.shadingMs = first ? took : this.shadingMs * 0.7 + took * 0.3;
  }
}

/** Of triangles that cross others newly, and of those that did in the rest pose. */
const MARKS = [0xe5342b, 0xe0a13a].map((color) => new THREE.MeshBasicMaterial({ color, side: THREE.DoubleSide }));
/** The same through what lies before them: most of what crosses is inside of something. */
const MARKS_BEHIND = MARKS.map(({ color, side }) => new THREE.MeshBasicMaterial({ color, side, transparent: true, opacity: 0.45, depthTest: false }));

function dynamic(attribute: THREE.BufferAttribute): THREE.BufferAttribute {
  attribute.setUsage(THREE.DynamicDrawUsage);
  return attribute;
}

/** Matt clay, cheap enough for weak graphics. */
function clay(flatShading: boolean): THREE.MeshLambertMaterial {
  return takePaint(new THREE.MeshLambertMaterial({ side: THREE.DoubleSide, flatShading, ...BEHIND_WIRE }));
}

/** Each edge of the triangles once, as pairs of vertices. */
function edges(indices: Uint32Array): Uint32Array<ArrayBuffer> {
  const keys = new Float64Array(indices.length);
  for (let k = 0; k < indices.length; k++) {
    const a = indices[k] as number;
    const b = indices[k % 3 === 2 ? k - 2 : k + 1] as number;
    keys[k] = Math.min(a, b) * 2 ** 26 + Math.max(a, b);
  }
  keys.sort();
  const out = new Uint32Array(indices.length * 2);
  let n = 0;
  for (let k = 0; k < keys.length; k++) {
    const key = keys[k] as number;
    if (k > 0 && keys[k - 1] === key) continue;
    out[n++] = Math.floor(key / 2 ** 26);
    out[n++] = key % 2 ** 26;
  }
  return out.slice(0, n);
}
