/** The axes along which a handle is moved, turned or scaled: lines through it. */

import * as THREE from "three";
import type { Stage } from "./stage.ts";

/** Colours of X, Y and Z, here and on the gizmo. */
export const AXIS_COLOURS = [0xf0625d, 0x5fbf6a, 0x4f94ff] as const;

/** A line to draw: an axis by its number, and where it points. */
export interface DrawnAxis {
  readonly axis: number;
  readonly direction: readonly [number, number, number];
}

export class Axes {
  private readonly lines: THREE.LineSegments<THREE.BufferGeometry, THREE.LineBasicMaterial>;

  constructor(private readonly stage: Stage) {
    this.lines = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ vertexColors: true, depthTest: false, transparent: true, opacity: 0.9 }));
    this.lines.frustumCulled = false;
    this.lines.renderOrder = 5;
    this.lines.visible = false;
    stage.scene.add(this.lines);
  }

  /** Draws lines through a place in place of those that were there. */
  show(at: readonly [number, number, number], axes: readonly DrawnAxis[]): void {
    // As far as from the eye to what it looks at: lines that go far behind it are not drawn by every driver.
    const reach = this.stage.camera.far / 20;
    const [places, colours]: [number[], number[]] = [[], []];
    for (const { axis, direction } of axes) {
      const colour = new THREE.Color(AXIS_COLOURS[axis] ?? 0xffffff);
      for (const way of [-reach, reach]) {
        places.push(...at.map((x, k) => x + way * (direction[k] as number)));
        colours.push(colour.r, colour.g, colour.b);
      }
    }
    const { geometry } = this.lines;
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(places, 3));
    geometry.setAttribute("color", new THREE.Float32BufferAttribute(colours, 3));
    this.lines.visible = axes.length > 0;
    this.stage.request();
  }
}
