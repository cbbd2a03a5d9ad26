/** The canvas: renderer, camera, light. Paints only when something changed. */

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import type { Surface } from "./surface.ts";

/** Colours of the scene by theme. */
const LOOKS = {
  dark: { background: 0x14181f, clay: 0xaab3c0, wire: 0x05080c, sky: 0xdfe8f5, ground: 0x3a4250, grid: 0x2a313c },
  light: { background: 0xeef1f5, clay: 0xb9c0ca, wire: 0x1c2530, sky: 0xffffff, ground: 0x9aa4b2, grid: 0xd3dae3 },
} as const;

/** Something that wants to act before each painted frame. */
export type Painter = (now: number) => void;

export class Stage {
  readonly scene = new THREE.Scene();
  readonly camera = new THREE.PerspectiveCamera(38, 1, 0.01, 100);
  readonly renderer: THREE.WebGLRenderer;
  readonly orbit: OrbitControls;
  readonly canvas: HTMLCanvasElement;
  surface: Surface | undefined;
  /** What is shown in the left half, seen as the surface is in the right one. */
  private beside: Surface | undefined;
  private readonly sky = new THREE.HemisphereLight(0xffffff, 0x444444, 1.5);
  private readonly lamp = new THREE.DirectionalLight(0xffffff, 1.9);
  private grid: THREE.GridHelper | undefined;
  private look: keyof typeof LOOKS = "dark";
  private readonly painters = new Set<Painter>();
  private scheduled = 0;

  constructor(host: HTMLElement) {
    this.renderer = new THREE.WebGLRenderer({ antialias: devicePixelRatio < 2, powerPreference: "high-performance" });
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    this.canvas = this.renderer.domElement;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", "The model; arrow keys orbit it");
    host.append(this.canvas);
    this.lamp.position.set(-0.6, 0.9, 1.2);
    this.camera.add(this.lamp);
    this.scene.add(this.camera, this.sky);
    this.orbit = new OrbitControls(this.camera, this.canvas);
    this.orbit.addEventListener("change", () => this.request());
    this.orbit.zoomToCursor = true;
    new ResizeObserver(() => this.resize(host)).observe(host);
    this.resize(host);
  }

  /** Asks for a painted frame. */
  request(): void {
    if (this.scheduled === 0) {
      this.scheduled = requestAnimationFrame((now) => {
        this.scheduled = 0;
        for (const painter of this.painters) painter(now);
        this.paint();
      });
    }
  }

  /** Has `painter` called before each painted frame, until what is returned is called. */
  beforePaint(painter: Painter): () => void {
    this.painters.add(painter);
    return () => this.painters.delete(painter);
  }

  /** What is shown, the surface first. */
  surfaces(): Surface[] {
    return [this.surface, this.beside].filter((surface) => surface !== undefined);
  }

  /** Shows a second surface in the left half, or none. */
  showBeside(surface: Surface | undefined): void {
    if (this.beside !== undefined) {
      this.scene.remove(this.beside.object);
      this.beside.dispose();
    }
    const changed = (surface === undefined) !== (this.beside === undefined);
    this.beside = surface;
    if (this.surface !== undefined) this.surface.object.visible = true;
    if (surface !== undefined) {
      this.scene.add(surface.object);
      this.setLook(this.look);
    }
    // Zooming towards the pointer would have to know in which half it is.
    this.orbit.zoomToCursor = surface === undefined;
    const { clientWidth, clientHeight } = this.canvas;
    if (changed && clientHeight > 0) this.setAspect(clientWidth, clientHeight);
    this.request();
  }

  /** Shows another surface, or none. */
  show(surface: Surface | undefined, frame: boolean): void {
    this.showBeside(undefined);
    if (this.surface !== undefined) {
      this.scene.remove(this.surface.object);
      this.surface.dispose();
    }
    this.surface = surface;
    if (surface !== undefined) {
      this.scene.add(surface.object);
      this.setLook(this.look);
      if (frame) this.frame(true);
    }
    this.setGrid();
    this.request();
  }

  setLook(look: keyof typeof LOOKS): void {
    this.look = look;
    const { background, clay, wire, sky, ground } = LOOKS[look];
    this.scene.background = new THREE.Color(background);
    this.sky.color.setHex(sky);
    this.sky.groundColor.setHex(ground);
    this.sky.intensity = look === "dark" ? 1.1 : 1.7;
    this.lamp.intensity = look === "dark" ? 1.8 : 1.6;
    for (const surface of this.surfaces()) surface.setTheme(clay, wire);
    this.setGrid();
    this.request();
  }

  /** Puts the whole shape into view; `reset` also takes the usual direction. */
  frame(reset = false): void {
    const ball = this.surface?.bounds();
    if (ball === undefined || !(ball.radius > 0)) return;
    const direction = reset
      ? new THREE.Vector3(0.45, 0.28, 1).normalize()
      : this.camera.position.clone().sub(this.orbit.target).normalize();
    const half = (this.camera.fov / 2) * (Math.PI / 180);
    const distance = (ball.radius * 1.12) / Math.sin(Math.min(half, Math.atan(Math.tan(half) * this.camera.aspect)));
    this.goTo(ball.center, direction, distance, distance * 20);
  }

  /** Looks at a place so that `radius` around it fills the picture: against `facing`, if that is a direction, else as before. */
  lookAt(at: THREE.Vector3, radius: number, facing?: THREE.Vector3): void {
    const before = this.camera.position.clone().sub(this.orbit.target).normalize();
    const from = facing !== undefined && facing.lengthSq() > 0.5 ? facing.clone().normalize() : before;
    // Straight from above or below the camera would turn over.
    from.y = Math.min(0.9, Math.max(-0.9, from.y));
    if (from.lengthSq() < 1e-6 || Math.hypot(from.x, from.z) < 1e-3) from.add(new THREE.Vector3(0.1, 0, 0.43));
    from.normalize();
    const half = (this.camera.fov / 2) * (Math.PI / 180);
    const distance = radius / Math.sin(Math.min(half, Math.atan(Math.tan(half) * this.camera.aspect)));
    const whole = this.surface?.bounds().radius ?? radius;
    this.goTo(at, from, distance, distance * 20 + whole * 4);
  }

  private goTo(at: THREE.Vector3, from: THREE.Vector3, distance: number, far: number): void {
    this.orbit.target.copy(at);
    this.camera.position.copy(at).addScaledVector(from, distance);
    this.camera.near = distance / 200;
    this.camera.far = far;
    this.camera.updateProjectionMatrix();
    this.orbit.update();
    this.request();
  }

  /** Whether a point lies well inside the picture. */
  sees(point: THREE.Vector3): boolean {
    const at = this.project(point);
    const { clientHeight: height } = this.canvas;
    const { left, width } = this.pane();
    return at !== undefined && Math.abs(at.x - left - width / 2) < width * 0.35 && Math.abs(at.y - height / 2) < height * 0.3;
  }

  /** Goes around the model by angles in radians, or nearer by a factor below 1. */
  circle(across: number, up: number, factor: number): void {
    const away = new THREE.Spherical().setFromVector3(this.camera.position.clone().sub(this.orbit.target));
    away.theta += across;
    away.phi += up;
    away.radius *= factor;
    this.camera.position.setFromSpherical(away.makeSafe()).add(this.orbit.target);
    this.orbit.update();
    this.request();
  }

  /** Looks at the same place, from as far, along a direction: radians around the vertical axis from the front, and up. */
  lookFrom(around: number, up: number): void {
    const away = new THREE.Spherical(this.camera.position.distanceTo(this.orbit.target), Math.PI / 2 - up, around);
    this.camera.position.setFromSpherical(away.makeSafe()).add(this.orbit.target);
    this.orbit.update();
    this.request();
  }

  /** Goes across the ground, and what is looked at with it. */
  shift(x: number, z: number): void {
    for (const place of [this.camera.position, this.orbit.target]) place.set(place.x + x, place.y, place.z + z);
    this.orbit.update();
    this.request();
  }

  /** A point of model space in CSS pixels of the canvas; `undefined` behind the camera. */
  project(point: THREE.Vector3): { x: number; y: number } | undefined {
    this.camera.updateMatrixWorld();
    const p = point.clone().project(this.camera);
    if (p.z > 1) return undefined;
    const { left, width } = this.pane();
    return { x: left + (p.x * 0.5 + 0.5) * width, y: (0.5 - p.y * 0.5) * this.canvas.clientHeight };
  }

  /** A place in CSS pixels of the canvas as a ray in model space. */
  rayThrough(x: number, y: number): THREE.Ray {
    const caster = new THREE.Raycaster();
    const { left, width } = this.pane();
    const at = new THREE.Vector2(((x - left) / width) * 2 - 1, 1 - (y / this.canvas.clientHeight) * 2);
    caster.setFromCamera(at, this.camera);
    return caster.ray;
  }

  /** Where on the canvas the surface is seen. */
  private pane(): { left: number; width: number } {
    const { clientWidth } = this.canvas;
    return this.beside === undefined ? { left: 0, width: clientWidth } : { left: clientWidth / 2, width: clientWidth / 2 };
  }

  private paint(): void {
    const { renderer, scene, camera, surface, beside } = this;
    if (beside === undefined || surface === undefined) return renderer.render(scene, camera);
    const { clientWidth, clientHeight } = this.canvas;
    const half = clientWidth / 2;
    renderer.setScissorTest(true);
    for (const [k, shown] of [beside, surface].entries()) {
      beside.object.visible = shown === beside;
      surface.object.visible = shown === surface;
      renderer.setViewport(k * half, 0, half, clientHeight);
      renderer.setScissor(k * half, 0, half, clientHeight);
      renderer.render(scene, camera);
    }
    renderer.setScissorTest(false);
    renderer.setViewport(0, 0, clientWidth, clientHeight);
  }

  private setAspect(width: number, height: number): void {
    this.camera.aspect = (this.beside === undefined ? width : width / 2) / height;
    this.camera.updateProjectionMatrix();
  }

  private setGrid(): void {
    if (this.grid !== undefined) {
      this.scene.remove(this.grid);
      this.grid.dispose();
      this.grid = undefined;
    }
    if (this.surface === undefined) return;
    const { box, diagonal } = this.surface.report;
    const size = 10 ** Math.ceil(Math.log10(diagonal || 1));
    const colour = LOOKS[this.look].grid;
    this.grid = new THREE.GridHelper(size * 2, 40, colour, colour);
    this.grid.position.set((box.min[0] + box.max[0]) / 2, box.min[1], (box.min[2] + box.max[2]) / 2);
    this.scene.add(this.grid);
  }

  private resize(host: HTMLElement): void {
    const { clientWidth: width, clientHeight: height } = host;
    if (width === 0 || height === 0) return;
    this.renderer.setSize(width, height);
    this.setAspect(width, height);
    this.request();
  }
}
