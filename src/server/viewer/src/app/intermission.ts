/**
 * What moves the surface without bending it (a clip, an animation) puts the pose that is edited aside. It comes back, with the
 * tool, when that ends: by the user, because another tool is taken, or because the session has gone on.
 */

import { effect, signal } from "@preact/signals";
import type { Surface } from "../scene/surface.ts";
import { repaint } from "./painting.ts";
import * as s from "./signals.ts";
import { view } from "./view.ts";

/** What is on the screen in place of the pose. */
export type Act = "clip" | "animation" | "rig";

interface Aside {
  readonly surface: Surface;
  readonly revision: bigint;
  readonly shape: Float32Array<ArrayBuffer>;
  readonly tool: s.Tool;
  readonly ended: () => void;
}

export const onScreen = signal<Act | undefined>(undefined);

let aside: Aside | undefined;

/** Puts the pose aside; `ended` is called before it comes back. */
export function putAside(act: Act, surface: Surface, ended: () => void): void {
  bringBack();
  aside = { surface, revision: s.currentRevision.peek(), shape: surface.positions.slice(), tool: s.tool.peek(), ended };
  onScreen.value = act;
  s.tool.value = "orbit";
}

/** Goes back to the pose that is being edited. */
export function bringBack(): void {
  const last = aside;
  aside = undefined;
  if (last === undefined) return;
  last.ended();
  onScreen.value = undefined;
  if (s.tool.peek() === "orbit") s.tool.value = last.tool;
  const { stage } = view();
  // A surface that was replaced has a shape of its own.
  if (stage.surface === last.surface) {
    last.surface.positions.set(last.shape);
    last.surface.moved(false);
    if (s.settings.peek().colouring === "stretch") repaint();
  }
  stage.request();
}

/** Has whatever is on the screen end when the user goes on editing. */
export function installIntermission(): void {
  effect(() => {
    if (s.tool.value !== "orbit" && onScreen.peek() !== undefined) bringBack();
  });
  effect(() => {
    const revision = s.currentRevision.value;
    if (aside !== undefined && (s.doc.value === undefined || revision !== aside.revision)) bringBack();
  });
}
