/**
 * What the user sees of the vertices from one point of view: their place on the screen, and whether something hides
 * them. Made when a stroke begins; the camera rests while it lasts.
 */

import * as THREE from "three";
import type { Stage } from "./stage.ts";
import type { Surface } from "./surface.ts";

export class ScreenView {
  /** x, y in CSS pixels per render vertex; NaN behind the camera. */
  readonly places: Float32Array;
  /** 1 where nothing hides the vertex. */
  readonly visible: Uint8Array;

  constructor(stage: Stage, surface: Surface) {
    const { positions } = surface;
    const vertices = positions.length / 3;
    this.places = new Float32Array(vertices * 2);
    this.visible = new Uint8Array(vertices);
    const { camera, canvas } = stage;
    camera.updateMatrixWorld();
    const view = camera.matrixWorldInverse.elements;
    const projection = camera.projectionMatrix.elements;
    const width = canvas.clientWidth;
    const height = canvas.clientHeight;
    const depths = distances(stage, surface, width, height);
    const slack = surface.report.diagonal * 0.006;
    for (let v = 0; v < vertices; v++) {
      const px = positions[v * 3] as number;
      const py = positions[v * 3 + 1] as number;
      const pz = positions[v * 3 + 2] as number;
      const x = at(view, 0, px, py, pz);
      const y = at(view, 1, px, py, pz);
      const z = at(view, 2, px, py, pz);
      if (z >= 0) {
        this.places[v * 2] = this.places[v * 2 + 1] = Number.NaN;
        continue;
      }
      const sx = ((((projection[0] as number) * x) / -z) * 0.5 + 0.5) * width;
      const sy = (0.5 - (((projection[5] as number) * y) / -z) * 0.5) * height;
      this.places[v * 2] = sx;
      this.places[v * 2 + 1] = sy;
      this.visible[v] = -z <= farthest(depths, width, height, sx, sy) + slack ? 1 : 0;
    }
  }

  /** Calls `take` for every vertex within `radius` pixels of a place. */
  within(x: number, y: number, radius: number, through: boolean, take: (vertex: number) => void): void {
    const { places, visible } = this;
    const limit = radius * radius;
    for (let v = 0; v < visible.length; v++) {
      const dx = (places[v * 2] as number) - x;
      const dy = (places[v * 2 + 1] as number) - y;
      if (dx * dx + dy * dy <= limit && (through || visible[v] === 1)) take(v);
    }
  }

  /** Calls `take` for every vertex inside a polygon of x, y pairs (even-odd rule). */
  inside(polygon: readonly number[], through: boolean, take: (vertex: number) => void): void {
    let [left, top, right, bottom] = [Infinity, Infinity, -Infinity, -Infinity];
    for (let k = 0; k < polygon.length; k += 2) {
      left = Math.min(left, polygon[k] as number);
      right = Math.max(right, polygon[k] as number);
      top = Math.min(top, polygon[k + 1] as number);
      bottom = Math.max(bottom, polygon[k + 1] as number);
    }
    for (let v = 0; v < this.visible.length; v++) {
      const x = this.places[v * 2] as number;
      const y = this.places[v * 2 + 1] as number;
      if (!(x >= left && x <= right && y >= top && y <= bottom)) continue;
      if ((through || this.visible[v] === 1) && surrounds(polygon, x, y)) take(v);
    }
  }
}

function at(m: readonly number[], row: number, x: number, y: number, z: number): number {
  return (
    (m[row] as number) * x + (m[row + 4] as number) * y + (m[row + 8] as number) * z + (m[row + 12] as number)
  );
}

function surrounds(polygon: readonly number[], x: number, y: number): boolean {
  let odd = false;
  let bx = polygon.at(-2) as number;
  let by = polygon.at(-1) as number;
  for (let k = 0; k < polygon.length; k += 2) {
    const ax = polygon[k] as number;
    const ay = polygon[k + 1] as number;
    if (ay > y !== by > y && x < ((bx - ax) * (y - ay)) / (by - ay) + ax) odd = !odd;
    bx = ax;
    by = ay;
  }
  return odd;
}

/** Of the pixels around a place the one that shows farthest: at an outline a vertex may lie a pixel off. */
function farthest(depths: Float32Array, width: number, height: number, x: number, y: number): number {
  const cx = Math.floor(x);
  const cy = Math.floor(y);
  let most = 0;
  for (let j = Math.max(0, cy - 1); j <= Math.min(height - 1, cy + 1); j++) {
    for (let i = Math.max(0, cx - 1); i <= Math.min(width - 1, cx + 1); i++) {
      most = Math.max(most, depths[j * width + i] as number);
    }
  }
  return most;
}

/** Distance along the view for every pixel, as drawn by the graphics card and read back. */
function distances(stage: Stage, surface: Surface, width: number, height: number): Float32Array {
  const target = new THREE.WebGLRenderTarget(width, height);
  const material = new THREE.MeshDepthMaterial({ depthPacking: THREE.RGBADepthPacking, side: THREE.DoubleSide });
  material.blending = THREE.NoBlending;
  const scene = new THREE.Scene();
  const mesh = new THREE.Mesh(surface.geometry, material);
  mesh.frustumCulled = false;
  scene.add(mesh);
  // A tight range keeps the packed depth precise.
  const camera = stage.camera.clone();
  const ball = surface.bounds();
  const eye = ball.center.distanceTo(camera.position);
  camera.near = Math.max(eye - ball.radius * 1.05, ball.radius / 500);
  camera.far = eye + ball.radius * 1.05;
  camera.updateProjectionMatrix();
  const { renderer } = stage;
  const colour = renderer.getClearColor(new THREE.Color());
  const alpha = renderer.getClearAlpha();
  renderer.setRenderTarget(target);
  renderer.setClearColor(0xffffff, 1);
  renderer.clear();
  renderer.render(scene, camera);
  const pixels = new Uint8Array(width * height * 4);
  renderer.readRenderTargetPixels(target, 0, 0, width, height, pixels);
  renderer.setRenderTarget(null);
  renderer.setClearColor(colour, alpha);
  target.dispose();
  material.dispose();
  const out = new Float32Array(width * height);
  const { near, far } = camera;
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      // The card counts rows from below.
      const from = ((height - 1 - row) * width + column) * 4;
      const [r, g, b, a] = [pixels[from], pixels[from + 1], pixels[from + 2], pixels[from + 3]] as [number, number, number, number];
      // Red carries the largest part, alpha the finest (three.js packing.glsl).
      const depth = r / 256 + g / 65536 + b / 16777216 + a / 4278190080;
      out[row * width + column] = (r & g & b & a) === 255 ? Infinity : (near * far) / (far - depth * (far - near));
    }
  }
  return out;
}
