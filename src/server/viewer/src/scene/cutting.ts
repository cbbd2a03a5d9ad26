/** The plane of a cut that is being prepared. */

import * as THREE from "three";
import type { Stage } from "./stage.ts";

export class CuttingPlane {
  private readonly plane: THREE.Mesh<THREE.PlaneGeometry, THREE.MeshBasicMaterial>;

  constructor(private readonly stage: Stage) {
    const material = new THREE.MeshBasicMaterial({
      color: 0xffb02e,
      transparent: true,
      opacity: 0.22,
      side: THREE.DoubleSide,
      depthWrite: false,
    });
    this.plane = new THREE.Mesh(new THREE.PlaneGeometry(1, 1), material);
    this.plane.visible = false;
    stage.scene.add(this.plane);
  }

  /** Shows it across the surface, or hides it. */
  show(cut: { normal: readonly [number, number, number]; offset: number } | undefined): void {
    const { surface } = this.stage;
    this.plane.visible = cut !== undefined && surface !== undefined;
    if (cut !== undefined && surface !== undefined) {
      const normal = new THREE.Vector3(...cut.normal).normalize();
      const { center, radius } = surface.bounds();
      const away = cut.offset / Math.hypot(...cut.normal) - normal.dot(center);
      this.plane.position.copy(center).addScaledVector(normal, away);
      this.plane.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), normal);
      this.plane.scale.setScalar(radius * 2.1);
    }
    this.stage.request();
  }
}
