/** The help sheet: how work goes, and every shortcut. */

import type { JSX } from "preact";
import { useEffect, useRef } from "preact/hooks";
import * as s from "../app/signals.ts";
import { SHORTCUTS } from "./keys.ts";
import { hasFingers, selectingMeans } from "./mouse.ts";
import { Button } from "./parts.tsx";

const CAPS: Record<string, string> = { ArrowLeft: "←", ArrowRight: "→", ArrowUp: "↑", ArrowDown: "↓", Escape: "Esc", Delete: "Del" };

export function Help(): JSX.Element {
  const sheet = useRef<HTMLDialogElement>(null);
  const open = s.helpOpen.value;
  useEffect(() => {
    if (open) sheet.current?.showModal();
    else sheet.current?.close();
  }, [open]);
  return (
    <dialog class="help" ref={sheet} aria-labelledby="help-title" onClose={() => (s.helpOpen.value = false)}>
      <header>
        <h1 id="help-title">How it works</h1>
        <Button bare icon="close" label="Close" onClick={() => (s.helpOpen.value = false)} />
      </header>
      <ol class="steps">
        <li>
          <b>Open</b> a model, or the sample creature.
        </li>
        <li>
          <b>Select</b> regions with the brush, box, lasso or a {hasFingers() ? "tap" : "click"} on a part.{" "}
          {selectingMeans(s.settings.value.looksWith)}
        </li>
        <li>
          <b>Pin</b> what stays, <b>grip</b> what moves. A <b>soft</b> handle pulls instead of holding.
        </li>
        <li>
          <b>Drag</b> the gizmo, or press <kbd>G</kbd>, <kbd>R</kbd> or <kbd>S</kbd> and move the pointer: <kbd>X</kbd>, <kbd>Y</kbd> and{" "}
          <kbd>Z</kbd> lock an axis, with Shift the plane across it; digits type the amount; Ctrl rounds it; Enter or a click keeps it. The newest pose always wins; releasing the button records it, Escape cancels it. Undo restores the exact shape;
          it also covers selections, in the order of your actions.
        </li>
        <li>
          <b>Edit</b> the triangles: cut by a plane or along a line, delete, fill, subdivide, decimate, smooth, weld, merge, or remesh what the remesh brush paints. Undo covers that, too.
        </li>
        <li>
          <b>Export</b> the model: unless it was edited, everything but positions, normals and tangents stays as it was in the file.
        </li>
        <li>
          <b>Write</b> the same as a script: <a href="/docs">every call of this server</a>.
        </li>
      </ol>
      <div class="shortcuts">
        {SHORTCUTS.map(({ title, list }) => (
          <section>
            <h2>{title}</h2>
            <dl>
              {list.map(({ keys, what }) => (
                <div>
                  <dt>
                    {(keys.length > 1 ? keys.split("+") : [keys]).map((key) => (
                      <kbd>{CAPS[key] ?? key}</kbd>
                    ))}
                  </dt>
                  <dd>{what}</dd>
                </div>
              ))}
            </dl>
          </section>
        ))}
      </div>
    </dialog>
  );
}
