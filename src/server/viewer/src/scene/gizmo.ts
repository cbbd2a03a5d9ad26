/**
 * The gizmo: a handle's pose as something to take hold of. It sits at the handle's pivot, moved by its translation;
 * rotation counts turns, so that a handle can be wound past 180°.
 */

import { type Vector, nearestRotationVector, quaternionOf } from "pliant-client";
import * as THREE from "three";
import { TransformControls } from "three/addons/controls/TransformControls.js";
import type { HandlePose } from "../model/handles.ts";
import { LEAST_SCALE, snapped } from "../model/transform.ts";
import { AXIS_COLOURS } from "./axes.ts";
import type { Stage } from "./stage.ts";

export interface GizmoEvents {
  /** The user took hold. */
  begin: () => void;
  /** The pose changed under the pointer. */
  change: (pose: HandlePose) => void;
  /** The user let go. */
  end: (pose: HandlePose) => void;
  /** The user gave it up; the pose is that of the beginning. */
  giveUp: (pose: HandlePose) => void;
}

export type GizmoMode = "translate" | "rotate" | "scale";

export class Gizmo {
  private readonly controls: TransformControls;
  private readonly grip = new THREE.Object3D();
  private pivot: Vector = [0, 0, 0];
  private rotation: Vector = [0, 0, 0];
  private mode: GizmoMode = "translate";
  /** Whether a handle that is moved turns automatically. */
  private freely = false;
  private attached = false;
  /** The length that moves are rounded to, if they are. */
  private step: number | undefined;
  /** The pose at which the drag began that is under way. */
  private began: HandlePose | undefined;

  constructor(
    private readonly stage: Stage,
    private readonly events: GizmoEvents,
  ) {
    this.controls = new TransformControls(stage.camera, stage.canvas);
    this.controls.setSize(0.85);
    this.controls.setColors(...AXIS_COLOURS, 0xffc14d);
    stage.scene.add(this.grip, this.controls.getHelper());
    this.controls.addEventListener("change", () => stage.request());
    this.controls.addEventListener("objectChange", () => {
      if (this.began === undefined) return;
      this.follow();
      events.change(this.pose());
    });
    this.controls.addEventListener("dragging-changed", (event) => {
      if (event.value === true) {
        stage.orbit.enabled = false;
        this.began = this.pose();
        events.begin();
      } else if (this.began !== undefined) {
        stage.orbit.enabled = true;
        this.began = undefined;
        events.end(this.pose());
      }
    });
  }

  /** Gives the drag up that is under way: its handle is where it was. */
  giveUp(): void {
    const { controls, stage, began } = this;
    if (!controls.dragging || began === undefined) return;
    this.began = undefined;
    controls.reset();
    this.rotation = began.rotation;
    controls.dragging = false;
    // The button is still down: what it does until it is let go is nobody's.
    stage.canvas.addEventListener("pointerup", () => (stage.orbit.enabled = true), { once: true });
    this.events.giveUp(began);
  }

  /** Whether the pointer is over one of its parts, or holds one. */
  get isHot(): boolean {
    return this.attached && (this.controls.axis !== null || this.controls.dragging);
  }

  /** The part under the pointer, such as X, XY or E (the ring that faces the eye). */
  get hotPart(): string | null {
    return this.controls.axis;
  }

  /** Whether it can be dragged. */
  set enabled(enabled: boolean) {
    this.controls.enabled = enabled;
    if (!enabled) this.controls.axis = null;
  }

  /** Rounds what is dragged to steps of a length, 5° and a tenth; not without a length. */
  snap(length: number | undefined): void {
    this.step = length;
    this.controls.setRotationSnap(length === undefined ? null : Math.PI / 36);
    this.controls.setScaleSnap(length === undefined ? null : 0.1);
  }

  /** Places it on a handle, whose pose is the one that a drag begins from; without one it hides. */
  attach(pivot: Vector | undefined, pose: HandlePose | undefined): void {
    this.attached = pivot !== undefined && pose !== undefined;
    if (pivot === undefined || pose === undefined) {
      this.controls.detach();
    } else if (!this.controls.dragging) {
      this.pivot = pivot;
      this.freely = pose.freely;
      this.rotation = pose.rotation;
      this.grip.position.set(...add(pivot, pose.translation));
      this.grip.quaternion.set(...(quaternionOf(pose.rotation) as [number, number, number, number]));
      this.grip.scale.set(...(pose.scale as [number, number, number]));
      this.controls.attach(this.grip);
    }
    this.stage.request();
  }

  setMode(mode: GizmoMode, localAxes: boolean): void {
    this.mode = mode;
    this.controls.setMode(mode);
    this.controls.setSpace(localAxes ? "local" : "world");
    this.stage.request();
  }

  /** Where the gizmo is. */
  get position(): THREE.Vector3 {
    return this.grip.position;
  }

  dispose(): void {
    this.controls.dispose();
  }

  private follow(): void {
    const { x, y, z, w } = this.grip.quaternion;
    if (this.mode === "rotate") this.rotation = nearestRotationVector([x, y, z, w], this.rotation);
    const from = this.began?.translation;
    if (this.mode === "translate" && from !== undefined) {
      // By how much, not to where: three.js would round the place.
      const start = add(this.pivot, from);
      this.grip.position.set(...(this.grip.position.toArray().map((x, k) => (start[k] as number) + snapped(x - (start[k] as number), this.step)) as [number, number, number]));
    }
    this.grip.scale.clampScalar(LEAST_SCALE, 1 / LEAST_SCALE);
  }

  private pose(): HandlePose {
    const { x, y, z } = this.grip.position;
    const scale = this.grip.scale;
    return {
      translation: [x - this.pivot[0], y - this.pivot[1], z - this.pivot[2]],
      rotation: this.rotation,
      scale: [scale.x, scale.y, scale.z],
      freely: this.freely && this.mode !== "rotate",
    };
  }
}

function add(a: Vector, b: Vector): [number, number, number] {
  return [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
}
