/** What the open model looks like, and which clips it has: read from the file that the server would export now. */

import { signal } from "@preact/signals";
import type { Session } from "pliant-client";
import { appearanceOf } from "../model/gltf/appearance.ts";
import { type ClipFacts, clipsOf } from "../model/gltf/clips.ts";
import { canvasOf } from "../model/gltf/drawn.ts";
import { type GltfFile, openGltf } from "../model/gltf/file.ts";
import { type SceneTree, treeOf } from "../model/gltf/scene.ts";
import type { Surface } from "../scene/surface.ts";
import { loadTextures } from "../scene/textures.ts";
import { doc, settings } from "./signals.ts";
import { view } from "./view.ts";

/** Models larger than this are shown as clay: fetching them twice would take longer than it is worth. */
const LARGEST = 512 << 20;

/** An exported file and its tree. */
export interface Exported {
  readonly file: GltfFile;
  readonly tree: SceneTree;
}

export interface Wardrobe {
  /** Whether the model says what it looks like. */
  readonly dressed: boolean;
  readonly clips: readonly ClipFacts[];
  /** What could not be drawn, a line each. */
  readonly faults: readonly string[];
}

const NOTHING: Wardrobe = { dressed: false, clips: [], faults: [] };

export const wardrobe = signal<Wardrobe>(NOTHING);

/** Asks for the session's shape as a GLB; `undefined` where that cannot be had. */
export async function exported(session: Session, companions: ReadonlyMap<string, Blob>): Promise<Exported | undefined> {
  if (Number(session.facts.model?.bytes ?? 0) > LARGEST) return undefined;
  const blob = await session.model("glb");
  const file = await openGltf(blob, companions);
  return { file, tree: treeOf(file) };
}

/** Whether the model came in a format whose skins and clips an export brings back. */
function isScene(session: Session): boolean {
  return ["glb", "gltf", "fbx"].includes(session.facts.model?.format ?? "");
}

/** Formats that say nothing of looks. */
function isBare(session: Session): boolean {
  return session.facts.model?.format === "stl";
}

/** Dresses the surface that is shown, as soon as its pictures are there. */
export async function dress(surface: Surface, session: Session, companions: ReadonlyMap<string, Blob>): Promise<void> {
  wardrobe.value = NOTHING;
  if (isBare(session)) return;
  const isShown = (): boolean => view().stage.surface === surface && doc.peek()?.session === session;
  try {
    const found = await exported(session, companions);
    if (found === undefined || !isShown()) return;
    const { file, tree } = found;
    const clips = isScene(session) ? clipsOf(file) : [];
    const canvas = canvasOf(file, tree, surface.topology, session.facts.primitives);
    const appearance = canvas && appearanceOf(file, tree, canvas);
    const faults = canvas === undefined ? ["the vertices of the exported model are in another order, so the page does not show its colours"] : [];
    if (appearance === undefined) {
      wardrobe.value = { dressed: false, clips, faults };
      return;
    }
    const { renderer } = view().stage;
    const { of, faults: missing } = await loadTextures(file, appearance.looks, renderer.capabilities.maxTextureSize);
    if (!isShown()) {
      for (const texture of of) texture?.dispose();
      return;
    }
    surface.dress(appearance, of);
    wardrobe.value = { dressed: true, clips, faults: [...faults, ...missing] };
    showLooks();
  } catch (error) {
    // The shape is on the screen, and can be bent: no reason to fail.
    if (isShown()) wardrobe.value = { ...NOTHING, faults: [`the model's colours cannot be loaded: ${error instanceof Error ? error.message : String(error)}`] };
  }
}

/** Shows the model as it looks where that is wanted; numbers are read off clay. */
export function showLooks(): void {
  const { stage } = view();
  const { materials, colouring } = settings.peek();
  for (const surface of stage.surfaces()) surface.showLooks(materials && colouring !== "stretch");
  stage.request();
}
