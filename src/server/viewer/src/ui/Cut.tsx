/** The plane of a cut: its direction, its place, and what stays. */

import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { type CutChoice, cut } from "../app/editing.ts";
import * as s from "../app/signals.ts";
import { view } from "../app/view.ts";
import { Button, Check, Choice, Field } from "./parts.tsx";

type Axis = "X" | "Y" | "Z" | "view";

export function Cut(): JSX.Element {
  const [axis, setAxis] = useState<Axis>("Y");
  const [choice, setChoice] = useState<CutChoice>({ keep: "BOTH", fill: true });
  const open = s.doc.value;
  const plane = s.cutPlane.value;
  const range = open === undefined ? undefined : alongAxis(axis);
  const show = (next: Axis): void => {
    setAxis(next);
    const { normal, low, high } = alongAxis(next);
    s.cutPlane.value = { normal, offset: (low + high) / 2 };
  };
  return (
    <fieldset>
      <legend>Cut by a plane</legend>
      <Choice
        label="Direction of the cut"
        value={plane === undefined ? ("" as Axis) : axis}
        options={[
          ["X", "X"],
          ["Y", "Y"],
          ["Z", "Z"],
          ["view", "view"],
        ]}
        onValue={show}
      />
      {plane !== undefined && range !== undefined && (
        <>
          <Field label="Place">
            <input
              type="range"
              min={range.low}
              max={range.high}
              step={(range.high - range.low) / 500}
              value={plane.offset}
              onInput={(event) => (s.cutPlane.value = { ...plane, offset: Number(event.currentTarget.value) })}
            />
          </Field>
          <Field label="Keep">
            <Choice
              label="Which sides stay"
              value={choice.keep}
              options={[
                ["BOTH", "both"],
                ["ABOVE", "above"],
                ["BELOW", "below"],
              ]}
              onValue={(keep) => setChoice({ ...choice, keep })}
            />
          </Field>
          <div class="row">
            <Check label="Close the cut" checked={choice.fill} onValue={(fill) => setChoice({ ...choice, fill })} />
            <span class="gap" />
            <Button label="Cancel" onClick={() => (s.cutPlane.value = undefined)} />
            <Button kind="main" label="Cut" onClick={() => void cut(choice)} />
          </div>
        </>
      )}
    </fieldset>
  );
}

/** The direction of a cut, and between which offsets the shape lies along it. */
function alongAxis(axis: Axis): { normal: [number, number, number]; low: number; high: number } {
  const { stage } = view();
  let normal: [number, number, number] = [axis === "X" ? 1 : 0, axis === "Y" ? 1 : 0, axis === "Z" ? 1 : 0];
  if (axis === "view") {
    // A plane through the line of sight, upright on the screen.
    const right = stage.camera.matrixWorld.elements;
    normal = [right[0] as number, right[1] as number, right[2] as number];
  }
  let [low, high] = [Infinity, -Infinity];
  const positions = stage.surface?.positions ?? new Float32Array();
  for (let k = 0; k < positions.length; k += 3) {
    const along = normal[0] * (positions[k] as number) + normal[1] * (positions[k + 1] as number) + normal[2] * (positions[k + 2] as number);
    low = Math.min(low, along);
    high = Math.max(high, along);
  }
  return { normal, low, high };
}
