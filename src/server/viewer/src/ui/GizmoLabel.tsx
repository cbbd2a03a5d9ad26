/** What the gizmo has done, beside it: how far, how many turns, how large. */

import { turnsOf } from "pliant-client";
import type { JSX } from "preact";
import * as s from "../app/signals.ts";
import { type Transforming, transforming } from "../app/transforming.ts";

export function GizmoLabel(): JSX.Element | null {
  const handle = s.activeHandle.value;
  const tool = s.tool.value;
  if (handle === undefined || handle.hold === "pin") return null;
  const running = transforming.value;
  if (running !== undefined) return <Running {...running} />;
  const { translation, rotation, scale } = handle.pose;
  if (tool === "rotate") {
    const angle = Math.hypot(...rotation);
    if (angle === 0) return null;
    return (
      <output class="tag">
        {degrees(angle)}
        <TurnCount angle={angle} />
      </output>
    );
  }
  if (tool === "move" && s.dragging.value) {
    return <output class="tag">{Math.hypot(...translation).toPrecision(3)}</output>;
  }
  if (tool === "scale" && s.dragging.value) {
    return <output class="tag">× {scale.map((x) => x.toFixed(2)).join(" · ")}</output>;
  }
  return null;
}

/** A transform that follows the pointer, or what is typed. */
function Running({ kind, lock, typed, amounts }: Transforming): JSX.Element {
  const names = "XYZ";
  const along = lock === undefined ? "" : `${lock.own ? "own " : ""}${lock.plane ? [...names].filter((_, k) => k !== lock.axis).join("") : names[lock.axis]} `;
  const said = amounts.map((x) => Number(x.toPrecision(3)));
  const amount = kind === "rotate" ? `${Math.round((said[0] ?? 0) * 10) / 10}°` : kind === "scale" ? `× ${said[0]}` : said.join(" · ");
  return (
    <output class="tag">
      {along}
      {typed === "" ? amount : <u>{typed}{kind === "rotate" && "°"}</u>}
    </output>
  );
}

/** Whole turns, once there is one. */
export function TurnCount({ angle }: { angle: number }): JSX.Element | null {
  const { turns, degrees: rest } = turnsOf(angle);
  if (turns === 0) return null;
  return (
    <span class="turns">
      {Math.abs(turns)} {Math.abs(turns) === 1 ? "turn" : "turns"} + {Math.round(rest)}°
    </span>
  );
}

function degrees(angle: number): string {
  return `${Math.round((angle * 180) / Math.PI)}°`;
}
