/** What the pointer does on the canvas: select by brush, box, lasso or part; choose handles; or look around. */

import { MOUSE, TOUCH } from "three";
import { pick } from "../scene/picking.ts";
import { ScreenView } from "../scene/screen.ts";
import { remesh } from "./editing.ts";
import * as s from "./signals.ts";
import { view } from "./view.ts";

/** Tools whose stroke selects; what the remesh brush selects is remeshed when it is lifted. */
const SELECTING: readonly s.Tool[] = ["brush", "box", "lasso", "part", "remesh"];
/** Tools that paint with a round brush. */
const PAINTING: readonly s.Tool[] = ["brush", "remesh"];
/** A press that moves less than this is a click. */
const CLICK_PIXELS = 4;

interface Stroke {
  readonly tool: s.Tool;
  readonly seen: ScreenView | undefined;
  readonly erase: boolean;
  readonly from: { x: number; y: number };
  readonly path: number[];
  readonly marks: Uint8Array<ArrayBuffer>;
}

let stroke: Stroke | undefined;
let pressed: { x: number; y: number } | undefined;

/** Listens on the canvas. */
export function installTools(): void {
  const { stage, overlay } = view();
  const { canvas } = stage;
  canvas.addEventListener("pointerdown", press);
  canvas.addEventListener("pointermove", move);
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", cancelStroke);
  canvas.addEventListener("pointerleave", () => overlay.hideBrush());
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
}

/** Gives the mouse buttons their meaning: with a selecting tool the left one selects and the right one looks around. */
export function armTool(tool: s.Tool): void {
  const { stage, overlay } = view();
  const selects = SELECTING.includes(tool);
  stage.orbit.mouseButtons = { LEFT: selects ? null : MOUSE.ROTATE, MIDDLE: MOUSE.PAN, RIGHT: selects ? MOUSE.ROTATE : MOUSE.PAN };
  stage.orbit.touches = { ONE: selects ? null : TOUCH.ROTATE, TWO: TOUCH.DOLLY_PAN };
  stage.canvas.dataset["tool"] = tool;
  overlay.clear();
}

export function clearSelection(): void {
  s.selection.value = new Uint8Array(s.selection.peek().length);
}

/** Selects what was not selected. */
export function invertSelection(): void {
  s.selection.value = s.selection.peek().map((x) => 1 - x);
}

function place(event: PointerEvent): { x: number; y: number } {
  const box = view().stage.canvas.getBoundingClientRect();
  return { x: event.clientX - box.left, y: event.clientY - box.top };
}

function press(event: PointerEvent): void {
  const { stage, gizmo } = view();
  const { surface } = stage;
  if (event.button !== 0 || surface === undefined) return;
  const at = place(event);
  const tool = s.tool.peek();
  if (!SELECTING.includes(tool)) {
    pressed = gizmo.isHot ? undefined : at;
    return;
  }
  stage.canvas.setPointerCapture(event.pointerId);
  const erase = event.altKey && tool !== "remesh";
  const keeps = tool !== "remesh" && (event.shiftKey || erase || tool === "brush");
  const marks = keeps ? new Uint8Array(s.selection.peek()) : new Uint8Array(s.selection.peek().length);
  const seen = tool === "part" ? undefined : new ScreenView(stage, surface);
  stroke = { tool, seen, erase, from: at, path: [at.x, at.y], marks };
  if (PAINTING.includes(tool)) dab(at.x, at.y);
}

function move(event: PointerEvent): void {
  const { overlay } = view();
  const at = place(event);
  if (PAINTING.includes(s.tool.peek()) && s.doc.peek() !== undefined) {
    overlay.brush(at.x, at.y, s.settings.peek().brushPixels, event.altKey);
  }
  if (stroke === undefined) return;
  if (PAINTING.includes(stroke.tool)) {
    dabsTo(at.x, at.y);
  } else if (stroke.tool === "box") {
    overlay.outline(boxBetween(stroke.from, at), stroke.erase);
  } else if (stroke.tool === "lasso") {
    const { path } = stroke;
    if (Math.hypot(at.x - (path.at(-2) as number), at.y - (path.at(-1) as number)) > 2) path.push(at.x, at.y);
    overlay.outline(path, stroke.erase);
  }
}

function release(event: PointerEvent): void {
  const at = place(event);
  if (pressed !== undefined) {
    const still = Math.hypot(at.x - pressed.x, at.y - pressed.y) < CLICK_PIXELS;
    pressed = undefined;
    if (still) chooseHandle(at.x, at.y);
  }
  const done = stroke;
  if (done === undefined) return;
  stroke = undefined;
  const still = Math.hypot(at.x - done.from.x, at.y - done.from.y) < CLICK_PIXELS;
  if (done.tool === "part") {
    markPart(at.x, at.y, done);
  } else if (done.tool === "box" || done.tool === "lasso") {
    const outline = done.tool === "box" ? boxBetween(done.from, at) : done.path;
    if (!still) done.seen?.inside(outline, s.settings.peek().throughSelect, (v) => mark(done, v));
    view().overlay.outline([], false);
  }
  s.selection.value = new Uint8Array(done.marks);
  if (done.tool === "remesh" && s.selectedCount.peek() > 0) void remesh();
}

function cancelStroke(): void {
  stroke = undefined;
  pressed = undefined;
  view().overlay.clear();
}

/** Dabs along the way from the last place, so that a quick stroke leaves no gaps. */
function dabsTo(x: number, y: number): void {
  if (stroke === undefined) return;
  const [fx, fy] = [stroke.path.at(-2) as number, stroke.path.at(-1) as number];
  const steps = Math.max(1, Math.ceil(Math.hypot(x - fx, y - fy) / (s.settings.peek().brushPixels * 0.6)));
  for (let k = 1; k <= steps; k++) dab(fx + ((x - fx) * k) / steps, fy + ((y - fy) * k) / steps);
  stroke.path.push(x, y);
}

function dab(x: number, y: number): void {
  const current = stroke;
  if (current === undefined) return;
  const { brushPixels, throughSelect } = s.settings.peek();
  current.seen?.within(x, y, brushPixels, throughSelect, (v) => mark(current, v));
  const { surface } = view().stage;
  // Where triangles are larger than the brush, the one under it stands for them.
  if (surface !== undefined && surface.topology.indices.length < 60_000) {
    const hit = pick(view().stage.rayThrough(x, y), surface.positions, surface.topology.indices);
    if (hit !== undefined) markPlace(current, hit.vertex);
  }
  s.selection.value = new Uint8Array(current.marks);
}

function mark({ marks, erase }: Stroke, vertex: number): void {
  marks[vertex] = erase ? 0 : 1;
}

/** Marks a vertex and its copies at the same place. */
function markPlace(current: Stroke, vertex: number): void {
  const placeOf = view().stage.surface?.report.placeOf;
  if (placeOf === undefined) return;
  const wanted = placeOf[vertex];
  for (let v = 0; v < placeOf.length; v++) if (placeOf[v] === wanted) mark(current, v);
}

function markPart(x: number, y: number, current: Stroke): void {
  const { stage } = view();
  const { surface } = stage;
  if (surface === undefined) return;
  const hit = pick(stage.rayThrough(x, y), surface.positions, surface.topology.indices);
  if (hit === undefined) return;
  const { partOf } = surface.report;
  const part = partOf[hit.vertex];
  for (let v = 0; v < partOf.length; v++) if (partOf[v] === part) mark(current, v);
}

/** A click with a gizmo tool: the handle whose dot or region is under it becomes the active one. */
function chooseHandle(x: number, y: number): void {
  const { stage, markers } = view();
  const { surface } = stage;
  if (surface === undefined) return;
  const marked = markers.at(x, y);
  if (marked !== undefined) {
    s.activeId.value = marked.id;
    return;
  }
  const hit = pick(stage.rayThrough(x, y), surface.positions, surface.topology.indices);
  if (hit === undefined) return;
  // Later handles win where regions overlap, as they do on the server.
  const found = s.handles.peek().findLast(({ vertices }) => vertices !== undefined && holds(vertices, hit.vertex));
  if (found !== undefined) s.activeId.value = found.id;
}

/** Whether an ascending list holds a number. */
function holds(list: Uint32Array, wanted: number): boolean {
  let [low, high] = [0, list.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if ((list[middle] as number) < wanted) low = middle + 1;
    else high = middle;
  }
  return list[low] === wanted;
}

function boxBetween(a: { x: number; y: number }, b: { x: number; y: number }): number[] {
  return [a.x, a.y, b.x, a.y, b.x, b.y, a.x, b.y];
}

