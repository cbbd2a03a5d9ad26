/** What the pointer does on the canvas: select by brush, box, lasso or part; choose handles; or look around. */

import { MOUSE, TOUCH } from "three";
import { pick } from "../scene/picking.ts";
import { ScreenView } from "../scene/screen.ts";
import { remesh } from "./editing.ts";
import { giveUpLeading } from "./leading.ts";
import { addPoint } from "./lines.ts";
import * as s from "./signals.ts";
import { did } from "./steps.ts";
import { giveUpTransform } from "./transforming.ts";
import { view } from "./view.ts";

/** Tools whose stroke selects; what the remesh brush selects is remeshed when it is lifted. */
const SELECTING: readonly s.Tool[] = ["brush", "box", "lasso", "part", "remesh"];
/** Tools that paint with a round brush. */
const PAINTING: readonly s.Tool[] = ["brush", "remesh"];
/** A press whose way is shorter than this is a click. */
const CLICK_PIXELS = 4;

interface Stroke {
  readonly tool: s.Tool;
  readonly seen: ScreenView | undefined;
  readonly erase: boolean;
  readonly from: Place;
  readonly path: number[];
  readonly marks: Uint8Array<ArrayBuffer>;
  /** What was selected before. */
  readonly before: Uint8Array;
}

interface Place {
  readonly x: number;
  readonly y: number;
}

/** How far the pointer has gone since it was pressed, and where it is: a way back to its start is not a click. */
interface Way {
  length: number;
  at: Place;
}

/** What a stroke is called when it is undone. */
const STROKES: Partial<Record<s.Tool, string>> = {
  brush: "Brush stroke",
  box: "Selection by box",
  lasso: "Selection by lasso",
  part: "Part selected",
  remesh: "Remesh brush",
};

let stroke: Stroke | undefined;
/** The way of the press that is under way, and whether it may choose a handle. */
let way: Way | undefined;
let choosing = false;

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
  // Browsers scroll by themselves while the middle button is held, or paste.
  canvas.addEventListener("mousedown", (event) => event.button === 1 && event.preventDefault());
}

/**
 * Gives the mouse buttons their meaning. The left one is the tool's, and looks around where the tool has no use for it; the others mean
 * the same with every tool: one looks around, or pans with Shift, the other one pans.
 */
export function armTool(tool: s.Tool, looksWith: s.LooksWith): void {
  const { stage, overlay } = view();
  const selects = SELECTING.includes(tool);
  const [MIDDLE, RIGHT] = looksWith === "middle" ? [MOUSE.ROTATE, MOUSE.PAN] : [MOUSE.PAN, MOUSE.ROTATE];
  stage.orbit.mouseButtons = { LEFT: selects ? null : MOUSE.ROTATE, MIDDLE, RIGHT };
  stage.orbit.touches = { ONE: selects ? null : TOUCH.ROTATE, TWO: TOUCH.DOLLY_PAN };
  stage.canvas.dataset["tool"] = tool;
  overlay.clear();
}

export function clearSelection(): void {
  s.selection.value = new Uint8Array(s.selection.peek().length);
  did("Selection cleared");
}

/** Selects what was not selected. */
export function invertSelection(): void {
  s.selection.value = s.selection.peek().map((x) => 1 - x);
  did("Selection inverted");
}

/** Makes a handle the active one. */
export function activate(id: string | undefined): void {
  s.activeId.value = id;
  const name = s.activeHandle.peek()?.name;
  did(name === undefined ? "No handle chosen" : `${name} chosen`);
}

/** Gives up what the pointer is doing, a stroke or a drag; whether it did anything. */
export function giveUpGesture(): boolean {
  if (giveUpTransform() || giveUpLeading()) return true;
  if (s.dragging.peek()) {
    view().gizmo.giveUp();
    return true;
  }
  if (stroke === undefined) return false;
  cancelStroke();
  return true;
}

function place(event: PointerEvent): Place {
  const box = view().stage.canvas.getBoundingClientRect();
  return { x: event.clientX - box.left, y: event.clientY - box.top };
}

function press(event: PointerEvent): void {
  const { stage, gizmo } = view();
  const { surface } = stage;
  if (event.button !== 0 || surface === undefined) return;
  const at = place(event);
  const tool = s.tool.peek();
  way = { length: 0, at };
  choosing = !SELECTING.includes(tool) && !gizmo.isHot;
  if (!SELECTING.includes(tool)) return;
  stage.canvas.setPointerCapture(event.pointerId);
  const erase = event.altKey && tool !== "remesh";
  const keeps = tool !== "remesh" && (event.shiftKey || erase || tool === "brush");
  const marks = keeps ? new Uint8Array(s.selection.peek()) : new Uint8Array(s.selection.peek().length);
  const seen = tool === "part" ? undefined : new ScreenView(stage, surface);
  stroke = { tool, seen, erase, from: at, path: [at.x, at.y], marks, before: s.selection.peek() };
  s.drawing.value = true;
  if (PAINTING.includes(tool)) dab(at.x, at.y);
}

function move(event: PointerEvent): void {
  const { overlay } = view();
  const at = place(event);
  follow(at);
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
  follow(at);
  const still = way !== undefined && way.length < CLICK_PIXELS;
  way = undefined;
  if (choosing && still && s.tool.peek() === "line") addPoint(at.x, at.y);
  else if (choosing && still) chooseHandle(at.x, at.y);
  choosing = false;
  const done = stroke;
  if (done === undefined) return;
  stroke = undefined;
  s.drawing.value = false;
  if (done.tool === "part") {
    markPart(at.x, at.y, done);
  } else if (done.tool === "box" || done.tool === "lasso") {
    const outline = done.tool === "box" ? boxBetween(done.from, at) : done.path;
    if (!still) done.seen?.inside(outline, s.settings.peek().throughSelect, (v) => mark(done, v));
    view().overlay.outline([], false);
  }
  s.selection.value = new Uint8Array(done.marks);
  const what = STROKES[done.tool] ?? "Selection";
  // What is remeshed is one step with its stroke; a stroke that could not be is a selection.
  if (done.tool === "remesh" && s.selectedCount.peek() > 0) void remesh().then(() => did(what));
  else did(what);
}

/** The browser takes the pointer away, or the user gives the stroke up: what was selected before is. */
function cancelStroke(): void {
  if (stroke !== undefined && stroke.before.length === s.selection.peek().length) s.selection.value = stroke.before;
  stroke = undefined;
  s.drawing.value = false;
  way = undefined;
  choosing = false;
  view().overlay.clear();
}

/** Notes that the pointer has gone on. */
function follow(at: Place): void {
  if (way === undefined) return;
  way.length += Math.hypot(at.x - way.at.x, at.y - way.at.y);
  way.at = at;
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
    activate(marked.id);
    return;
  }
  const hit = pick(stage.rayThrough(x, y), surface.positions, surface.topology.indices);
  if (hit === undefined) return;
  // Later handles win where regions overlap, as they do on the server.
  const found = s.handles.peek().findLast(({ vertices }) => vertices !== undefined && holds(vertices, hit.vertex));
  if (found !== undefined) activate(found.id);
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

function boxBetween(a: Place, b: Place): number[] {
  return [a.x, a.y, b.x, a.y, b.x, b.y, a.x, b.y];
}

