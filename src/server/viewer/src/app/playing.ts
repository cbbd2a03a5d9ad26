/** Clips on the deformed shape. While one plays, the pose is put aside; it comes back when the clip is closed. */

import { signal } from "@preact/signals";
import { Puppet } from "../model/gltf/puppet.ts";
import type { Surface } from "../scene/surface.ts";
import { frameShown } from "./camera.ts";
import { exported, wardrobe } from "./dressing.ts";
import { putAside } from "./intermission.ts";
import * as s from "./signals.ts";
import { view } from "./view.ts";

/** A clip on the screen. */
export interface Playing {
  readonly clip: number;
  readonly seconds: number;
  readonly running: boolean;
}

export const playing = signal<Playing | undefined>(undefined);
export const playSpeed = signal(1);
/** Whether the file with the clip is being fetched. */
export const fetchingClip = signal(false);

interface Act {
  readonly surface: Surface;
  readonly puppet: Puppet;
  /** When the last step was made. */
  last: number | undefined;
  /** Whether the camera was asked to look. */
  framed: boolean;
}

let act: Act | undefined;
/** The files that `.gltf` models name, for exports that name them still. */
let companions: ReadonlyMap<string, Blob> = new Map();

/** Files that came with the open model. */
export function companionsOfModel(): ReadonlyMap<string, Blob> {
  return companions;
}

/** Files that came with the open model. */
export function setCompanions(files: ReadonlyMap<string, Blob>): void {
  companions = files;
}

/** Plays a clip from its start, or goes on with the one that is shown. */
export async function playClip(clip: number): Promise<void> {
  const shown = playing.peek();
  if (shown?.clip === clip) {
    const over = shown.seconds >= (wardrobe.peek().clips[clip]?.duration ?? 0);
    playing.value = { ...shown, running: true, seconds: over ? 0 : shown.seconds };
  } else if (shown !== undefined) {
    playing.value = { clip, seconds: 0, running: true };
  } else if (await begin()) {
    playing.value = { clip, seconds: 0, running: true };
  }
  if (act !== undefined) act.last = undefined;
  show();
}

export function pauseClip(): void {
  const shown = playing.peek();
  if (shown !== undefined) playing.value = { ...shown, running: false };
}

/** Shows the clip at a time. */
export function seekClip(seconds: number): void {
  const shown = playing.peek();
  if (shown === undefined) return;
  playing.value = { ...shown, seconds, running: false };
  show();
}

/** Has clips advance before each painted frame. */
export function installPlaying(): void {
  view().stage.beforePaint(advance);
}

/** Fetches the current shape with everything that moves it. */
async function begin(): Promise<boolean> {
  const open = s.doc.peek();
  const { surface } = view().stage;
  if (open === undefined || surface === undefined || fetchingClip.peek()) return false;
  fetchingClip.value = true;
  try {
    const revision = s.currentRevision.peek();
    const found = await exported(open.session, companions);
    // The model may have been edited or closed meanwhile.
    if (found === undefined || view().stage.surface !== surface || s.currentRevision.peek() !== revision || s.dragging.peek()) return false;
    const puppet = new Puppet(found.file, found.tree, open.session.origin);
    putAside("clip", surface, () => {
      act = undefined;
      playing.value = undefined;
    });
    act = { surface, puppet, last: undefined, framed: false };
    return true;
  } catch (error) {
    s.fail("The clip cannot be played", error);
    return false;
  } finally {
    fetchingClip.value = false;
  }
}

function advance(now: number): void {
  const shown = playing.peek();
  if (shown === undefined || act === undefined || !shown.running) return;
  const { duration = 0 } = wardrobe.peek().clips[shown.clip] ?? {};
  // A page that was hidden for a while does not catch up.
  const passed = act.last === undefined ? 0 : Math.min(0.25, (now - act.last) / 1000);
  act.last = now;
  const seconds = duration > 0 ? (shown.seconds + passed * playSpeed.peek()) % duration : 0;
  playing.value = { ...shown, seconds, running: duration > 0 };
  show();
}

function show(): void {
  const shown = playing.peek();
  if (shown === undefined || act === undefined) return;
  const { puppet, surface } = act;
  puppet.pose(shown.clip, shown.seconds, surface.positions);
  surface.moved(shown.running);
  frameShown(surface);
  if (!act.framed) {
    act.framed = true;
    // Clips may stand elsewhere than the pose, or walk away from it; those that stay are not jumped at.
    if (!view().stage.sees(surface.bounds().center)) view().stage.frame();
  }
  view().stage.request();
}
