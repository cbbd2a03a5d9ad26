/**
 * G, R and S: the active handle follows the pointer without a button, until Enter or a click keeps it, or Escape or the right button
 * gives it up. X, Y and Z lock an axis, with Shift the plane across it; digits type the amount, Ctrl snaps.
 */

import { effect, signal } from "@preact/signals";
import type { Vector } from "pliant-client";
import { Plane, type Ray, Vector3 } from "three";
import type { HandlePose } from "../model/handles.ts";
import { LEAST_SCALE, type Lock, type TransformKind, axisOf, movedBy, scaledBy, snapped, turnedBy } from "../model/transform.ts";
import { commitPoses, dragTo, giveUpDrag } from "./dragging.ts";
import { startOf } from "./handling.ts";
import { onScreen } from "./intermission.ts";
import * as s from "./signals.ts";
import { view } from "./view.ts";

/** What is shown of a transform that is under way. */
export interface Transforming {
  readonly kind: TransformKind;
  readonly lock: Lock | undefined;
  /** What was typed; empty while the pointer says how much. */
  readonly typed: string;
  /** How far in model units, by how many degrees, or how many times. */
  readonly amounts: readonly number[];
}

interface Place {
  readonly x: number;
  readonly y: number;
}

/** A transform that is under way. */
interface Run {
  readonly id: string;
  readonly before: HandlePose;
  readonly start: HandlePose;
  readonly pivot: Vector;
  /** Where the pointer was, on the canvas; without, the next place that it is seen at. */
  from: Place | undefined;
  at: Place | undefined;
  /** Radians that the pointer has gone around the handle. */
  around: number;
  snaps: boolean;
}

/** Radians and share that Ctrl rounds turns and scales to. */
const SNAP_TURN = Math.PI / 36;
const SNAP_SCALE = 0.1;
const DEGREES = 180 / Math.PI;
const AXES = "xyz";

export const transforming = signal<Transforming | undefined>(undefined);

let run: Run | undefined;
/** Where the pointer was seen last. */
let pointer: Place | undefined;

/** Lengths that Ctrl rounds to, and a press of an arrow in a field moves by. */
export function lengthStep(): number {
  return Number(((s.doc.peek()?.report.diagonal ?? 1) / 100).toPrecision(1));
}

/** Takes the tool, and begins a transform where a handle is chosen that can be moved. */
export function beginTransform(kind: TransformKind): void {
  s.tool.value = kind;
  const handle = s.activeHandle.peek();
  if (handle === undefined || handle.hold === "pin" || handle.guide !== undefined || onScreen.peek() !== undefined || s.dragging.peek()) return;
  const from = pointer === undefined ? undefined : onCanvas(pointer);
  run = { id: handle.id, before: handle.pose, start: startOf(handle, kind), pivot: handle.pivot, from, at: from, around: 0, snaps: false };
  view().gizmo.enabled = false;
  s.dragging.value = true;
  transforming.value = { kind, lock: undefined, typed: "", amounts: [] };
  apply();
}

/** Gives up the transform that is under way; whether there was one. */
export function giveUpTransform(): boolean {
  const ended = end();
  if (ended === undefined) return false;
  void giveUpDrag(ended.id, ended.before);
  return true;
}

/** Records the transform that is under way, if it has changed anything. */
function keep(): void {
  const ended = end();
  if (ended === undefined) return;
  const pose = s.handles.peek().find(({ id }) => id === ended.id)?.pose;
  if (JSON.stringify(pose) === JSON.stringify(ended.start)) void giveUpDrag(ended.id, ended.before);
  else void commitPoses([ended.id]);
}

function end(): Run | undefined {
  const ended = run;
  run = undefined;
  if (ended === undefined) return undefined;
  transforming.value = undefined;
  s.dragging.value = false;
  view().gizmo.enabled = true;
  view().axes.show([0, 0, 0], []);
  return ended;
}

/** A key while a transform is under way; whether it means something to it. */
export function transformKey(event: KeyboardEvent): boolean {
  const shown = transforming.peek();
  if (shown === undefined || run === undefined) return false;
  const key = event.key.toLowerCase();
  const kind = ({ g: "move", r: "rotate", s: "scale" } as const)[key];
  if (key === "escape") return giveUpTransform();
  if (key === "control") return snap(true);
  if (event.ctrlKey || event.metaKey || event.altKey) return false;
  if (key === "enter") keep();
  else if (kind !== undefined) {
    giveUpTransform();
    beginTransform(kind);
  } else if (key.length === 1 && AXES.includes(key)) change({ lock: nextLock(shown.lock, AXES.indexOf(key), event.shiftKey) });
  else if (/^[0-9]$/.test(key)) change({ typed: shown.typed + key });
  else if ((key === "." || key === ",") && !shown.typed.includes(".")) change({ typed: `${shown.typed}.` });
  else if (key === "-") change({ typed: shown.typed.startsWith("-") ? shown.typed.slice(1) : `-${shown.typed}` });
  else if (key === "backspace") change({ typed: shown.typed.slice(0, -1) });
  // Other keys wait: what they do belongs to a shape that stands still.
  return true;
}

/** An axis pressed twice is the handle's own, or the model's where the gizmo has its own; pressed again, nothing is locked. */
function nextLock(lock: Lock | undefined, axis: number, plane: boolean): Lock | undefined {
  const first = s.settings.peek().localAxes;
  if (lock?.axis !== axis || lock.plane !== plane) return { axis, plane, own: first };
  return lock.own === first ? { ...lock, own: !first } : undefined;
}

function change(part: Partial<Transforming>): void {
  const shown = transforming.peek();
  if (shown === undefined) return;
  transforming.value = { ...shown, ...part };
  apply();
}

function snap(snaps: boolean): boolean {
  if (run === undefined) return false;
  run.snaps = snaps;
  apply();
  return true;
}

/** Shows the handle as the transform has it now. */
function apply(): void {
  const [shown, now] = [transforming.peek(), run];
  if (shown === undefined || now === undefined) return;
  const { kind, lock, typed } = shown;
  const number = typed === "" || Number.isNaN(Number(typed)) ? undefined : Number(typed);
  const { pose, amounts } = RESULTS[kind](now, lock, number);
  transforming.value = { ...shown, amounts };
  drawAxes(now, kind, lock);
  dragTo(now.id, pose);
}

interface Result {
  readonly pose: HandlePose;
  readonly amounts: readonly number[];
}

/** The pose of each kind of transform, by the pointer or by the number that was typed. */
const RESULTS: Readonly<Record<TransformKind, (now: Run, lock: Lock | undefined, typed: number | undefined) => Result>> = { move, rotate, scale };

function move(now: Run, lock: Lock | undefined, typed: number | undefined): Result {
  const step = now.snaps ? lengthStep() : undefined;
  const axis = lock && axisOf(lock, now.start.rotation);
  let by: Vector;
  if (typed !== undefined) {
    // As elsewhere: without an axis a number goes along X, in a plane along its first axis.
    const first = { axis: lock === undefined ? 0 : lock.plane && lock.axis === 0 ? 1 : lock.plane ? 0 : lock.axis, own: lock?.own ?? false, plane: false };
    by = times(axisOf(first, now.start.rotation), typed);
  } else {
    const far = dragged(now, axis, lock?.plane === true);
    by = axis !== undefined && lock?.plane === false ? times(axis, snapped(dot(far, axis), step)) : (far.map((x) => snapped(x, step)) as unknown as Vector);
  }
  const along = axis !== undefined && lock?.plane === false ? [dot(by, axis)] : by;
  return { pose: movedBy(now.start, by), amounts: along };
}

function rotate(now: Run, lock: Lock | undefined, typed: number | undefined): Result {
  const eye = view().stage.camera.position.clone().sub(place(now)).normalize();
  const axis: Vector = lock === undefined ? [eye.x, eye.y, eye.z] : axisOf(lock, now.start.rotation);
  // The pointer turns what it goes around, from whichever side the axis is seen.
  const side = dot(axis, [eye.x, eye.y, eye.z]) < 0 ? -1 : 1;
  const angle = typed === undefined ? snapped(now.around * side, now.snaps ? SNAP_TURN : undefined) : typed / DEGREES;
  return { pose: turnedBy(now.start, axis, angle), amounts: [angle * DEGREES] };
}

function scale(now: Run, lock: Lock | undefined, typed: number | undefined): Result {
  const middle = view().stage.project(place(now));
  const away = (at: Place | undefined): number => (at === undefined || middle === undefined ? 1 : Math.max(1, Math.hypot(at.x - middle.x, at.y - middle.y)));
  const factor = Math.max(LEAST_SCALE, typed ?? snapped(away(now.at) / away(now.from), now.snaps ? SNAP_SCALE : undefined));
  return { pose: scaledBy(now.start, factor, lock), amounts: [factor] };
}

/** How far the pointer has dragged the handle: along an axis, in the plane across it, or in that of the screen. */
function dragged({ from, at, ...now }: Run, axis: Vector | undefined, plane: boolean): Vector {
  const { stage } = view();
  if (from === undefined || at === undefined) return [0, 0, 0];
  const middle = place(now);
  const meet = (ray: Ray): Vector3 | undefined => {
    if (axis !== undefined && !plane) return nearestOnAxis(ray, middle, new Vector3(...axis));
    const normal = axis === undefined ? stage.camera.getWorldDirection(new Vector3()) : new Vector3(...axis);
    return ray.intersectPlane(new Plane().setFromNormalAndCoplanarPoint(normal, middle), new Vector3()) ?? undefined;
  };
  const [was, is] = [meet(stage.rayThrough(from.x, from.y)), meet(stage.rayThrough(at.x, at.y))];
  return was === undefined || is === undefined ? [0, 0, 0] : [is.x - was.x, is.y - was.y, is.z - was.z];
}

/** The point of an axis that a ray passes nearest to; none where it looks along the axis. */
function nearestOnAxis(ray: Ray, through: Vector3, axis: Vector3): Vector3 | undefined {
  const along = ray.direction.dot(axis);
  const apart = 1 - along * along;
  if (apart < 1e-4) return undefined;
  const away = ray.origin.clone().sub(through);
  return through.clone().addScaledVector(axis, (away.dot(axis) - along * away.dot(ray.direction)) / apart);
}

function drawAxes(now: Run, kind: TransformKind, lock: Lock | undefined): void {
  const numbers = lock === undefined ? [] : [0, 1, 2].filter((axis) => (axis === lock.axis) !== (lock.plane && kind !== "rotate"));
  const { x, y, z } = place(now);
  // Scales lie along the handle's own axes, whatever the lock says.
  view().axes.show([x, y, z], numbers.map((axis) => ({ axis, direction: axisOf({ axis, plane: false, own: kind === "scale" || lock?.own === true }, now.start.rotation) })));
}

/** Where the handle was when the transform began. */
function place({ start, pivot }: Pick<Run, "start" | "pivot">): Vector3 {
  return new Vector3(...pivot).add(new Vector3(...start.translation));
}

function dot(a: Vector, b: Vector): number {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

function times([x, y, z]: Vector, by: number): Vector {
  return [x * by, y * by, z * by];
}

function onCanvas({ x, y }: Place): Place {
  const box = view().stage.canvas.getBoundingClientRect();
  return { x: x - box.left, y: y - box.top };
}

/** Follows the pointer wherever it is on the page. */
export function installTransforming(): void {
  addEventListener("pointermove", (event) => {
    pointer = { x: event.clientX, y: event.clientY };
    view().gizmo.snap(event.ctrlKey ? lengthStep() : undefined);
    if (run === undefined) return;
    const at = onCanvas(pointer);
    const middle = view().stage.project(place(run));
    run.from ??= at;
    if (middle !== undefined && run.at !== undefined) {
      // The screen's y goes down, so that what looks counterclockwise is negative.
      const angle = Math.atan2(run.at.y - middle.y, run.at.x - middle.x) - Math.atan2(at.y - middle.y, at.x - middle.x);
      run.around += angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));
    }
    run.at = at;
    run.snaps = event.ctrlKey;
    apply();
    // Before the gizmo gets the event.
  }, { capture: true });
  addEventListener("pointerdown", press, { capture: true });
  addEventListener("keyup", (event) => event.key === "Control" && snap(false));
  effect(() => {
    const active = s.activeHandle.value?.id;
    if (run !== undefined && active !== run.id) giveUpTransform();
  });
}

/** A press ends a transform before anything else sees it: on the canvas it does nothing more. */
function press(event: PointerEvent): void {
  if (run === undefined || event.button === 1) return;
  if (event.button === 2) giveUpTransform();
  else keep();
  if (event.target !== view().stage.canvas) return;
  event.preventDefault();
  event.stopImmediatePropagation();
}
