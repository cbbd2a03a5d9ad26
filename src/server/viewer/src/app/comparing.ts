/** Linear blend skinning beside an animation: the model's own clip as any engine plays it, on a surface of its own. */

import { signal } from "@preact/signals";
import { type FilmFrame, carry, inverse } from "../model/film.ts";
import { openGltf } from "../model/gltf/file.ts";
import { Puppet } from "../model/gltf/puppet.ts";
import { treeOf } from "../model/gltf/scene.ts";
import { Surface } from "../scene/surface.ts";
import { type Exported, exported } from "./dressing.ts";
import { documentNow } from "./opening.ts";
import { repaint } from "./painting.ts";
import { companionsOfModel } from "./playing.ts";
import * as s from "./signals.ts";
import { view } from "./view.ts";

/** Whether there is a skin whose blend can be shown. */
export const hasComparison = signal(false);

let puppet: Puppet | undefined;
let clip = 0;
let beside: Surface | undefined;

/**
 * Gets the model in the rest pose with its skin, where the animation plays a clip of it; nothing if cancelled
 * meanwhile.
 */
export async function prepareComparison(own: number | undefined, isWanted: () => boolean): Promise<void> {
  dropComparison();
  const open = s.doc.peek();
  if (own === undefined || open === undefined) return;
  try {
    const found = await atRest();
    if (found === undefined || !isWanted()) return;
    const { file, tree } = found;
    const vertices = tree.placements.reduce((sum, { vertices: count }) => sum + count, 0);
    const isSkinned = tree.placements.some(({ node }) => tree.nodes[node]?.["skin"] !== undefined);
    if (!isSkinned || vertices * 3 !== open.rest.length) return;
    puppet = new Puppet(file, tree, open.session.origin);
    clip = own;
    hasComparison.value = true;
  } catch {
    // The animation itself does not need it.
  }
}

/** The model in the rest pose: as the server writes it while nothing is bent, else as uploaded. */
async function atRest(): Promise<Exported | undefined> {
  const open = s.doc.peek();
  const shown = documentNow();
  if (open === undefined) return undefined;
  const format = open.session.facts.model?.format ?? "";
  const { commits, current } = await open.session.history();
  const [first] = commits;
  const now = commits.find(({ revision }) => revision === current);
  // A past that was cut off does not tell what rest is.
  if (first?.kind === "create" && first.digest === now?.digest) return exported(open.session, companionsOfModel());
  if (shown?.model === undefined || !["glb", "gltf"].includes(format)) return undefined;
  const file = await openGltf(shown.model, companionsOfModel());
  return { file, tree: treeOf(file) };
}

export function dropComparison(): void {
  puppet = undefined;
  hasComparison.value = false;
  beside = undefined;
  view().stage.showBeside(undefined);
}

/** How a frame is to be shown. */
interface Shown extends FilmFrame {
  readonly followsRoot: boolean;
  readonly moving: boolean;
}

/** Shows the blend beside a surface, at a frame if one is given; without a surface it leaves. */
export function showComparison(surface: Surface | undefined, frame?: Shown): void {
  const { stage } = view();
  const open = s.doc.peek();
  if (surface === undefined || puppet === undefined || open === undefined) {
    beside = undefined;
    stage.showBeside(undefined);
    return;
  }
  if (beside === undefined) {
    const { wire, materials, colouring } = s.settings.peek();
    beside = new Surface(open.topology, open.report, open.rest);
    beside.dressLike(surface);
    beside.setWire(wire);
    beside.showLooks(materials && colouring !== "stretch");
    stage.showBeside(beside);
    repaint();
  }
  if (frame === undefined) return;
  beside.positions.set(open.rest);
  puppet.pose(clip, frame.time, beside.positions);
  if (!frame.followsRoot) carry(beside.positions, inverse(frame.root), beside.positions);
  beside.moved(frame.moving);
}
