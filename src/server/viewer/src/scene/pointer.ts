/** A ring around a place that is pointed at, drawn over everything until the canvas is touched. */

import * as THREE from "three";
import type { Stage } from "./stage.ts";

export class Pointer {
  private readonly ring: THREE.Points<THREE.BufferGeometry, THREE.PointsMaterial>;

  constructor(private readonly stage: Stage) {
    const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(3), 3));
    const material = new THREE.PointsMaterial({ size: 44, sizeAttenuation: false, depthTest: false, transparent: true, map: ring(), color: 0xffb02e });
    this.ring = new THREE.Points(geometry, material);
    this.ring.frustumCulled = false;
    this.ring.renderOrder = 6;
    this.ring.visible = false;
    stage.scene.add(this.ring);
    stage.canvas.addEventListener("pointerdown", () => this.hide());
  }

  show(at: THREE.Vector3): void {
    this.ring.position.copy(at);
    this.ring.visible = true;
    this.stage.request();
  }

  hide(): void {
    this.ring.visible = false;
    this.stage.request();
  }

  get isShown(): boolean {
    return this.ring.visible;
  }
}

function ring(): THREE.Texture {
  const size = 96;
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = size;
  const paint = canvas.getContext("2d");
  if (paint !== null) {
    for (const [width, style] of [
      [11, "rgba(0,0,0,.6)"],
      [6, "#fff"],
    ] as const) {
      paint.beginPath();
      paint.lineWidth = width;
      paint.strokeStyle = style;
      paint.arc(size / 2, size / 2, size / 2 - 8, 0, 2 * Math.PI);
      paint.stroke();
    }
  }
  return new THREE.CanvasTexture(canvas);
}
