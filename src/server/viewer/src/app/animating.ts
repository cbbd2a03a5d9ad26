/**
 * Animations: the server solves every frame of a clip for the rest shape; the page keeps the frames and plays them.
 * Handles, shape and history of the session have no part in it.
 */

import { computed, effect, signal } from "@preact/signals";
import { type AnimateOptions, PliantError, schema } from "pliant-client";
import { type FilmFrame, MOST_FILM_BYTES, around, carry, everyThatFits, filmBytes, frameAt, frameSeconds } from "../model/film.ts";
import { recordingFacts } from "../model/recording.ts";
import type { Surface } from "../scene/surface.ts";
import { frameShown } from "./camera.ts";
import { dropComparison, hasComparison, prepareComparison, showComparison } from "./comparing.ts";
import { wardrobe } from "./dressing.ts";
import { bringBack, putAside } from "./intermission.ts";
import { repaint } from "./painting.ts";
import { frameEncoding } from "./packing.ts";
import { playSpeed } from "./playing.ts";
import { showDoubts } from "./rigging.ts";
import * as s from "./signals.ts";
import { origin } from "./space.ts";
import { view } from "./view.ts";

/** What is to be played. */
export interface ClipSource {
  readonly title: string;
  /** The number of one of the model's own clips. */
  readonly own?: number;
  readonly bvh?: Blob;
  /** What a rig file holds. */
  readonly rig?: unknown;
}

/** How the clip is taken. */
export interface ClipOptions {
  /** Frames a second; 0 = the clip's own. */
  readonly fps: number;
  readonly first: number;
  /** 0 = all that follow. */
  readonly count: number;
  /** How often rotations are fitted in a frame; -1 = once, going on from the frame before. */
  readonly refine: number;
}

/** An animation on the screen. */
export interface Animating {
  readonly source: ClipSource;
  /** Frames that are there, and that are wanted. */
  readonly kept: number;
  readonly wanted: number;
  /** Which of those that are there is shown. */
  readonly at: number;
  readonly running: boolean;
}

/** Frames that are on their way. */
export interface Coming {
  readonly perSecond: number;
  readonly cancel: () => void;
}

/** An animation that does not fit into the page, and what would. */
export interface TooLong {
  readonly source: ClipSource;
  readonly frames: number;
  readonly bytes: number;
  /** Options under which it fits, with what they mean. */
  readonly ways: readonly { readonly says: string; readonly options: ClipOptions }[];
}

export const clipOptions = signal<ClipOptions>({ fps: 0, first: 0, count: 0, refine: -1 });
export const animating = signal<Animating | undefined>(undefined);
/** What was to be played last, in the model that is open. */
export const lastSource = signal<ClipSource | undefined>(undefined);
export const coming = signal<Coming | undefined>(undefined);
export const tooLong = signal<TooLong | undefined>(undefined);
export const animationReport = signal<schema.AnimationReport | undefined>(undefined);
/** Whether the model goes where the clip's root goes, or stays in its place. */
export const followsRoot = signal(true);
export const loops = signal(true);
/** Whether linear blend skinning is shown beside it, where it can be. */
export const comparing = signal(true);
export const isCompared = computed(() => comparing.value && hasComparison.value && animating.value !== undefined);

interface Film {
  readonly surface: Surface;
  readonly options: ClipOptions;
  readonly frames: FilmFrame[];
  /** Ends what is on its way for it. */
  control: AbortController;
  seconds: number;
  last: number | undefined;
}

let film: Film | undefined;
let abort: AbortController | undefined;
/** The session that was open last: frames of another one are not wanted. */
let openLast: string | undefined;
/** The sign that is up until the first frame is there. */
let sign: s.Busy | undefined;

/** What the server takes of a clip that was not recorded in frames. */
const USUAL_RATE = 30;

/** Has the server solve a clip, and shows its frames as they come. What was shown before stays until the first is there. */
export async function animate(source: ClipSource, options: ClipOptions = clipOptions.peek()): Promise<void> {
  const { surface } = view().stage;
  if (s.doc.peek() === undefined || surface === undefined) {
    s.note("error", "No model is open", "Open a model first, then the clip.");
    return;
  }
  abort?.abort();
  lastSource.value = source;
  const mine = (abort = new AbortController());
  s.dismissErrors();
  tooLong.value = undefined;
  sign = { title: `Animating by ${source.title}`, detail: "The server reads the clip and sets its handles", cancel: () => mine.abort() };
  s.busy.value = sign;
  try {
    await receive(source, options, { surface, options, frames: [], control: mine, seconds: 0, last: undefined });
  } finally {
    if (abort === mine) {
      abort = undefined;
      coming.value = undefined;
      takeSignDown();
    }
  }
}

function takeSignDown(): void {
  if (s.busy.peek() === sign) s.busy.value = undefined;
  sign = undefined;
}

/** Asks for the frames after the last one that came. */
export async function goOn(): Promise<void> {
  const shown = animating.peek();
  const mine = film;
  if (shown === undefined || mine === undefined || abort !== undefined) return;
  const last = mine.frames.at(-1)?.index ?? 0;
  const control = (abort = mine.control = new AbortController());
  try {
    await receive(shown.source, { ...mine.options, first: last + 1, count: shown.wanted - mine.frames.length }, mine);
  } finally {
    if (abort === control) {
      abort = undefined;
      coming.value = undefined;
    }
  }
}

async function receive(source: ClipSource, options: ClipOptions, into: Film): Promise<void> {
  const open = s.doc.peek();
  const { control } = into;
  const { signal } = control;
  if (open === undefined) return;
  const vertices = open.rest.length / 3;
  const animation = open.session.animate(requestOf(source, options, vertices), { signal });
  const from = into.frames.length;
  let begun = 0;
  try {
    for await (const { index, count, time, rootTranslation, rootRotation, frame } of animation) {
      if (signal.aborted || view().stage.surface !== into.surface) return;
      const kept = into.frames.length;
      const wanted = from + (options.count > 0 ? Math.min(options.count, count - options.first) : count - options.first);
      if (kept === 0 && !(await fits(source, options, wanted, count, vertices))) return;
      const positions = new Float32Array(open.rest);
      frame.positionsInto(positions);
      const root = around(origin(), { translation: rootTranslation, rotation: rootRotation });
      into.frames.push({ index, time, root, positions });
      if (kept === 0) raise(source, into, wanted);
      if (film !== into) return;
      begun ||= performance.now();
      const rate = ((into.frames.length - from - 1) * 1000) / Math.max(1, performance.now() - begun);
      coming.value = { perSecond: rate, cancel: () => control.abort() };
      const shown = animating.peek();
      if (shown !== undefined) animating.value = { ...shown, kept: into.frames.length, wanted };
      view().stage.request();
    }
    if (film === into) animationReport.value = animation.report;
  } catch (error) {
    // Another model has taken the place of the one that was to move: nobody waits for its clip.
    if (signal.aborted || s.doc.peek()?.session !== open.session) return;
    s.fail(into.frames.length === 0 ? "The clip cannot be played" : "No more frames arrived", error);
    // Joints that are not sure are shown, to be put where they belong.
    const refused = error instanceof PliantError && error.code === "INVALID_ARGUMENT" && source.bvh !== undefined && source.rig === undefined;
    if (!refused || into.frames.length > 0) return;
    takeSignDown();
    void showDoubts(source);
  }
}

/** What is asked of the server. Positions are wanted as the root sees them: the page carries them itself. */
function requestOf(source: ClipSource, options: ClipOptions, vertices: number): AnimateOptions {
  const { own, bvh, rig } = source;
  return {
    ...(own !== undefined && { clip: own }),
    ...(bvh !== undefined && { bvh }),
    ...(rig !== undefined && { rig }),
    fps: options.fps,
    first: options.first,
    count: options.count,
    ...(options.refine >= 0 && { refine: options.refine }),
    root: schema.AnimateOptions_Root.NODE,
    output: { encoding: frameEncoding(vertices) },
  };
}

/** Whether all frames fit into the page; says what would otherwise. */
async function fits(source: ClipSource, options: ClipOptions, wanted: number, count: number, vertices: number): Promise<boolean> {
  const bytes = filmBytes(wanted, vertices);
  if (bytes <= MOST_FILM_BYTES) return true;
  const recorded = source.bvh === undefined ? undefined : (await recordingFacts(source.bvh)).frameTime;
  const { duration = 0 } = wardrobe.peek().clips[source.own ?? -1] ?? {};
  const own = recorded !== undefined ? 1 / recorded : duration > 0 && count > 1 ? (count - 1) / duration : USUAL_RATE;
  const rate = options.fps > 0 ? options.fps : own;
  const every = everyThatFits(wanted, vertices);
  const most = Math.floor(MOST_FILM_BYTES / filmBytes(1, vertices));
  const fewer = { ...options, fps: rate / every, first: Math.floor(options.first / every), count: options.count > 0 ? Math.floor(options.count / every) : 0 };
  const ways = [
    { says: `One frame of ${every}, ${Number((rate / every).toPrecision(3))} a second`, options: fewer },
    { says: `The first ${most.toLocaleString("en")}`, options: { ...options, count: most } },
  ];
  tooLong.value = { source, frames: wanted, bytes, ways: most > 0 ? ways : [] };
  return false;
}

/** Puts an animation on the screen in place of what was there. */
function raise(source: ClipSource, mine: Film, wanted: number): void {
  takeSignDown();
  const { stage } = view();
  putAside("animation", mine.surface, () => closed(mine));
  film = mine;
  animationReport.value = undefined;
  animating.value = { source, kept: 1, wanted, at: 0, running: true };
  show(0);
  if (!stage.sees(mine.surface.bounds().center)) stage.frame();
  // Frames do not wait for it.
  void prepareComparison(source.own, () => film === mine).then(() => film === mine && hasComparison.peek() && compare());
}

/** Leaves the screen to the pose; frames that are still on their way are not wanted. */
function closed(ended: Film): void {
  ended.control.abort();
  film = undefined;
  animating.value = undefined;
  coming.value = undefined;
  animationReport.value = undefined;
  dropComparison();
}

export function closeAnimation(): void {
  bringBack();
}

export function playAnimation(): void {
  const shown = animating.peek();
  if (shown === undefined || film === undefined) return;
  const over = shown.at === shown.kept - 1 && shown.kept === shown.wanted;
  film.last = undefined;
  if (over) seekFrame(0);
  animating.value = { ...(animating.peek() as Animating), running: true };
  view().stage.request();
}

export function pauseAnimation(): void {
  const shown = animating.peek();
  if (shown === undefined) return;
  animating.value = { ...shown, running: false };
  show(shown.at);
}

/** Shows a frame of those that are there, and stops at it. */
export function seekFrame(at: number): void {
  const shown = animating.peek();
  if (shown === undefined || film === undefined) return;
  const frame = Math.min(shown.kept - 1, Math.max(0, Math.round(at)));
  animating.value = { ...shown, at: frame, running: false };
  film.seconds = film.frames[frame]?.time ?? 0;
  show(frame);
}

/** Seconds of the clip at a frame that is there. */
export function secondsAt(at: number): number {
  return film?.frames[at]?.time ?? 0;
}

/** Puts linear blend skinning beside it, or takes it away. */
function compare(): void {
  if (film === undefined) return;
  showComparison(isCompared.peek() ? film.surface : undefined);
  view().stage.frame();
  show(animating.peek()?.at ?? 0);
}

function advance(now: number): void {
  const shown = animating.peek();
  if (shown === undefined || film === undefined || !shown.running) return;
  const { frames } = film;
  const [first, last] = [frames[0]?.time ?? 0, frames.at(-1)?.time ?? 0];
  // A page that was hidden for a while does not catch up.
  const passed = film.last === undefined ? 0 : Math.min(0.25, (now - film.last) / 1000) * playSpeed.peek();
  film.last = now;
  const step = frameSeconds(frames);
  const end = last + step;
  let seconds = Math.max(first, film.seconds + passed);
  let running: boolean = shown.running;
  if (shown.kept < shown.wanted) {
    // What is not there yet is waited for.
    seconds = Math.min(seconds, last);
    running = abort !== undefined || seconds < last;
  } else if (seconds >= end) {
    running = loops.peek() && step > 0;
    seconds = running ? first + ((seconds - first) % (end - first)) : last;
  }
  film.seconds = seconds;
  const at = frameAt(frames, seconds);
  if (at !== shown.at || running !== shown.running) {
    animating.value = { ...shown, at, running };
    show(at);
  }
  if (running) view().stage.request();
}

function show(at: number): void {
  const frame = film?.frames[at];
  if (film === undefined || frame === undefined) return;
  const { surface } = film;
  const moving = animating.peek()?.running === true;
  if (followsRoot.peek()) carry(frame.positions, frame.root, surface.positions);
  else surface.positions.set(frame.positions);
  surface.moved(moving);
  frameShown(surface);
  if (isCompared.peek()) showComparison(surface, { ...frame, followsRoot: followsRoot.peek(), moving });
  if (s.settings.peek().colouring === "stretch") repaint();
  view().stage.request();
}

/** Has animations advance before each painted frame, and follow what is chosen while they are shown. */
export function installAnimating(): void {
  view().stage.beforePaint(advance);
  effect(() => {
    void followsRoot.value;
    show(animating.peek()?.at ?? 0);
    if (film !== undefined && !view().stage.sees(film.surface.bounds().center)) view().stage.frame();
  });
  effect(() => {
    void comparing.value;
    compare();
  });
  effect(() => {
    const session = s.doc.value?.session.id;
    if (session === undefined || session !== openLast) {
      abort?.abort();
      tooLong.value = undefined;
      lastSource.value = undefined;
    }
    openLast = session;
  });
}

/** What a rig file holds; the server says what is wrong in it. */
export async function rigOf(file: Blob): Promise<unknown> {
  try {
    return JSON.parse(await file.text());
  } catch (error) {
    throw new PliantError("INVALID_ARGUMENT", `the rig is not JSON: ${error instanceof Error ? error.message : String(error)}`);
  }
}
