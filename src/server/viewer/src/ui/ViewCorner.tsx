/** The corner of the canvas that turns the view: the model's axes, each of which looks along itself, and what frames and follows. */

import type { JSX } from "preact";
import { useEffect, useRef } from "preact/hooks";
import { Vector3 } from "three";
import { animating } from "../app/animating.ts";
import { cameraFollows } from "../app/camera.ts";
import { playing } from "../app/playing.ts";
import { view } from "../app/view.ts";
import { Button } from "./parts.tsx";

const NAMES = ["X", "Y", "Z"] as const;
/** Where the eye is for each direction: radians around the vertical axis from the front, and up. */
const VIEWS: readonly (readonly [name: string, from: string, around: number, up: number])[] = [
  ["X", "right", Math.PI / 2, 0],
  ["Y", "top", 0, Math.PI / 2],
  ["Z", "front", 0, 0],
  ["−X", "left", -Math.PI / 2, 0],
  ["−Y", "bottom", 0, -Math.PI / 2],
  ["−Z", "back", Math.PI, 0],
];
/** Pixels from the middle of the axes to their ends. */
const REACH = 30;
/** A view along an axis is one whose direction differs from it by less. */
const SAME = 1e-3;

export function ViewCorner(): JSX.Element {
  const host = useRef<HTMLDivElement>(null);
  useEffect(() => {
    const { stage } = view();
    const end = stage.beforePaint(() => place(host.current));
    stage.request();
    return end;
  }, []);
  const moves = animating.value !== undefined || playing.value !== undefined;
  return (
    <div class="view-corner">
      <div class="axes" role="group" aria-label="Views" ref={host}>
        <svg viewBox="-44 -44 88 88" aria-hidden="true">
          {NAMES.map((name) => (
            <line class={`axis-${name.toLowerCase()}`} />
          ))}
        </svg>
        {VIEWS.map(([name, from], k) => (
          <button
            type="button"
            class={`axis-${NAMES[k % 3]?.toLowerCase()}${k > 2 ? " back" : ""}`}
            title={`View from the ${from}`}
            aria-label={`View from the ${from}`}
            onClick={() => lookAlong(k)}
          >
            {k < 3 && <span>{name}</span>}
          </button>
        ))}
      </div>
      <Button bare icon="frame" label="Frame the model" keys="F" onClick={() => view().stage.frame()} />
      {moves && (
        <Button bare icon="follow" label="Camera follows the model" pressed={cameraFollows.value} onClick={() => (cameraFollows.value = !cameraFollows.peek())} />
      )}
    </div>
  );
}

/** Where the end of an axis is, as the camera sees it: across, up, and towards the eye. */
function seen(k: number): Vector3 {
  const { camera } = view().stage;
  camera.updateMatrixWorld();
  const end = new Vector3(...[0, 1, 2].map((axis) => (axis === k % 3 ? (k > 2 ? -1 : 1) : 0)));
  return end.transformDirection(camera.matrixWorldInverse);
}

function place(host: HTMLElement | null): void {
  for (const [k, button] of [...(host?.querySelectorAll("button") ?? [])].entries()) {
    const { x, y, z } = seen(k);
    button.style.transform = `translate(${x * REACH}px, ${-y * REACH}px)`;
    button.style.zIndex = String(Math.round(10 + z * 8));
  }
  for (const [k, line] of [...(host?.querySelectorAll("line") ?? [])].entries()) {
    const { x, y } = seen(k);
    line.setAttribute("x2", String(x * REACH));
    line.setAttribute("y2", String(-y * REACH));
  }
}

/** Looks from an axis; from where the view is already, it looks from the other side. */
function lookAlong(k: number): void {
  const [, , around, up] = VIEWS[1 - seen(k).z < SAME ? (k + 3) % 6 : k] as (typeof VIEWS)[number];
  view().stage.lookFrom(around, up);
}
