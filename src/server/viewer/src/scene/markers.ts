/** A dot at each handle, drawn over the surface, so that handles are found from any side. */

import * as THREE from "three";
import { type HandleState, colourOf } from "../model/handles.ts";
import type { Stage } from "./stage.ts";

/** How near in CSS pixels a click must be. */
const REACH = 12;

export class Markers {
  private readonly points: THREE.Points<THREE.BufferGeometry, THREE.PointsMaterial>;
  private shown: readonly HandleState[] = [];

  constructor(private readonly stage: Stage) {
    const material = new THREE.PointsMaterial({
      size: 13,
      sizeAttenuation: false,
      vertexColors: true,
      depthTest: false,
      transparent: true,
      map: disc(),
      alphaTest: 0.02,
    });
    this.points = new THREE.Points(new THREE.BufferGeometry(), material);
    this.points.frustumCulled = false;
    this.points.renderOrder = 5;
    stage.scene.add(this.points);
  }

  /** Shows a dot for each handle where it is now. */
  show(handles: readonly HandleState[]): void {
    this.shown = handles;
    const positions = new Float32Array(handles.length * 3);
    const colours = new Float32Array(handles.length * 3);
    handles.forEach((handle, k) => {
      positions.set(placeOf(handle).toArray(), k * 3);
      const [r, g, b] = colourOf(handle);
      new THREE.Color().setRGB(r / 255, g / 255, b / 255, THREE.SRGBColorSpace).toArray(colours, k * 3);
    });
    const { geometry } = this.points;
    geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
    this.points.visible = handles.length > 0;
    this.stage.request();
  }

  /** The handle whose dot is at this place of the canvas. */
  at(x: number, y: number): HandleState | undefined {
    let best: HandleState | undefined;
    let nearest = REACH;
    for (const handle of this.shown) {
      const p = this.stage.project(placeOf(handle));
      const distance = p === undefined ? Infinity : Math.hypot(p.x - x, p.y - y);
      if (distance <= nearest) {
        nearest = distance;
        best = handle;
      }
    }
    return best;
  }
}

/** Where a handle's pivot is now. */
export function placeOf({ pivot, pose }: HandleState): THREE.Vector3 {
  return new THREE.Vector3(...pivot).add(new THREE.Vector3(...pose.translation));
}

/** A white dot with a dark rim. */
export function disc(): THREE.Texture {
  const size = 64;
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = size;
  const paint = canvas.getContext("2d");
  if (paint !== null) {
    paint.fillStyle = "rgba(0,0,0,.55)";
    paint.arc(size / 2, size / 2, size / 2 - 2, 0, 2 * Math.PI);
    paint.fill();
    paint.beginPath();
    paint.fillStyle = "#fff";
    paint.arc(size / 2, size / 2, size / 2 - 10, 0, 2 * Math.PI);
    paint.fill();
  }
  return new THREE.CanvasTexture(canvas);
}
