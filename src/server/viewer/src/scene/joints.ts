/** The joints of a rig and the bones between them, or the points of a guide: drawn over the surface, and dragged along the screen. */

import * as THREE from "three";
import { disc } from "./markers.ts";
import type { Stage } from "./stage.ts";

/** How near in CSS pixels a press must be. */
const REACH = 14;

/** A joint as it is drawn. */
export interface DrawnJoint {
  readonly name: string;
  readonly at: readonly [number, number, number];
  readonly colour: THREE.ColorRepresentation;
}

/** What is reported of a drag: it begins, goes on, and ends. */
export interface JointEvents {
  readonly moved: (name: string, at: [number, number, number]) => void;
  readonly dropped: (name: string) => void;
}

export class Joints {
  private readonly points: THREE.Points<THREE.BufferGeometry, THREE.PointsMaterial>;
  private readonly lines: THREE.LineSegments<THREE.BufferGeometry, THREE.LineBasicMaterial>;
  private shown: readonly DrawnJoint[] = [];
  private held: { readonly name: string; readonly plane: THREE.Plane; moved: boolean } | undefined;

  constructor(
    private readonly stage: Stage,
    private readonly events: JointEvents,
  ) {
    const over = { depthTest: false, transparent: true, vertexColors: true } as const;
    this.points = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ ...over, size: 15, sizeAttenuation: false, map: disc(), alphaTest: 0.02 }));
    this.lines = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ depthTest: false, transparent: true, opacity: 0.85, color: 0xe8eef6 }));
    for (const [k, object] of [this.lines, this.points].entries()) {
      object.frustumCulled = false;
      object.renderOrder = 7 + k;
      object.visible = false;
      stage.scene.add(object);
    }
    const { canvas } = stage;
    // Before whatever else a press on the canvas means.
    canvas.addEventListener("pointerdown", (event) => this.press(event), { capture: true });
    canvas.addEventListener("pointermove", (event) => this.move(event), { capture: true });
    for (const end of ["pointerup", "pointercancel"] as const) canvas.addEventListener(end, (event) => this.release(event), { capture: true });
  }

  /** Shows joints, and bones by the names of the joints that they join. */
  show(joints: readonly DrawnJoint[], bones: readonly (readonly [string, string])[]): void {
    this.shown = joints;
    const place = new Map(joints.map(({ name, at }) => [name, at]));
    const ends = bones.flatMap(([from, to]) => [...(place.get(from) ?? []), ...(place.get(to) ?? [])]);
    this.lines.geometry.setAttribute("position", new THREE.BufferAttribute(Float32Array.from(ends), 3));
    this.points.geometry.setAttribute("position", new THREE.BufferAttribute(Float32Array.from(joints.flatMap(({ at }) => at)), 3));
    const colours = joints.flatMap(({ colour }) => new THREE.Color(colour).toArray());
    this.points.geometry.setAttribute("color", new THREE.BufferAttribute(Float32Array.from(colours), 3));
    this.points.visible = this.lines.visible = joints.length > 0;
    this.stage.request();
  }

  /** Lets go of the joint that is dragged; the button does nothing more until it is released. */
  letGo(): void {
    if (this.held === undefined) return;
    this.held = undefined;
    this.stage.canvas.addEventListener("pointerup", () => (this.stage.orbit.enabled = true), { once: true });
  }

  /** The joint whose dot is at this place of the canvas; of several the nearest to the eye. */
  private at(x: number, y: number): DrawnJoint | undefined {
    const distance = ({ at }: DrawnJoint): number => {
      const p = this.stage.project(new THREE.Vector3(...at));
      return p === undefined ? Infinity : Math.hypot(p.x - x, p.y - y);
    };
    const near = this.shown.filter((joint) => distance(joint) <= REACH);
    return near.sort((a, b) => distance(a) - distance(b))[0];
  }

  private press(event: PointerEvent): void {
    if (event.button !== 0 || this.shown.length === 0) return;
    const joint = this.at(...this.place(event));
    if (joint === undefined) return;
    const { camera, canvas, orbit } = this.stage;
    const facing = camera.getWorldDirection(new THREE.Vector3());
    this.held = { name: joint.name, plane: new THREE.Plane().setFromNormalAndCoplanarPoint(facing, new THREE.Vector3(...joint.at)), moved: false };
    orbit.enabled = false;
    canvas.setPointerCapture(event.pointerId);
    event.stopImmediatePropagation();
  }

  private move(event: PointerEvent): void {
    const { held } = this;
    const [x, y] = this.place(event);
    if (held === undefined) {
      if (this.shown.length > 0) this.stage.canvas.style.cursor = this.at(x, y) === undefined ? "" : "grab";
      return;
    }
    const at = this.stage.rayThrough(x, y).intersectPlane(held.plane, new THREE.Vector3());
    if (at !== null) {
      held.moved = true;
      this.events.moved(held.name, at.toArray());
    }
    event.stopImmediatePropagation();
  }

  private release(event: PointerEvent): void {
    const { held } = this;
    if (held === undefined) return;
    this.held = undefined;
    this.stage.orbit.enabled = true;
    event.stopImmediatePropagation();
    // One that is only clicked on is right where it is.
    const joint = this.shown.find(({ name }) => name === held.name);
    if (!held.moved && joint !== undefined) this.events.moved(held.name, [...joint.at]);
    this.events.dropped(held.name);
  }

  private place(event: PointerEvent): [number, number] {
    const box = this.stage.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }
}
