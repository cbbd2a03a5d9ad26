/** Which colours the surface shows: handle regions, the selection, and stretch. */

import { colourOf } from "../model/handles.ts";
import { stretchColour } from "../model/stretch.ts";
import type { Surface } from "../scene/surface.ts";
import { activeId, handles, selection, settings } from "./signals.ts";
import { view } from "./view.ts";

const SELECTED = [255, 176, 46, 235] as const;

/** Repaints what is shown. The stretch picture omits regions, but never the selection. */
export function repaint(): void {
  const { stage } = view();
  for (const surface of stage.surfaces()) paint(surface);
  stage.request();
}

function paint(surface: Surface): void {
  const { colouring } = settings.peek();
  const selected = selection.peek();
  const active = activeId.peek();
  if (colouring === "stretch") surface.measureStretch();
  surface.repaint((colours) => {
    if (colouring === "stretch") {
      for (let v = 0; v < surface.stretch.length; v++) stretchColour(surface.stretch[v] as number, colours, v * 4);
    } else {
      colours.fill(0);
    }
    if (colouring === "handles") {
      for (const handle of handles.peek()) {
        const [r, g, b] = colourOf(handle);
        const strength = handle.id === active || handle.hold === "pin" ? 235 : 165;
        for (const v of handle.vertices ?? []) {
          const at = v * 4;
          colours[at] = r;
          colours[at + 1] = g;
          colours[at + 2] = b;
          colours[at + 3] = strength;
        }
      }
    }
    for (let v = 0; v < selected.length; v++) {
      if (selected[v] === 1) colours.set(SELECTED, v * 4);
    }
  });
}
