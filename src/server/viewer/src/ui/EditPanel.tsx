/** Operations on the topology: cut, subdivide, smooth, remesh. */

import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { type CutChoice, cut, remesh, smooth, subdivide } from "../app/editing.ts";
import * as s from "../app/signals.ts";
import { view } from "../app/view.ts";
import { Button, Check, Choice, Field, NumberInput, Section, count } from "./parts.tsx";

type Axis = "X" | "Y" | "Z" | "view";

export function EditPanel(): JSX.Element {
  const refused = s.editsRefused.value;
  const selected = s.selectedCount.value;
  return (
    <Section title="Edit" open={false} {...(refused === undefined ? {} : { note: "not on this server" })}>
      {refused !== undefined && (
        <p class="warning">
          This server does not edit: {refused}.
          <small>Deforming is not affected.</small>
        </p>
      )}
      <Cut disabled={refused !== undefined} />
      <p class="hint">
        {selected > 0 ? `The next three work on the ${count(selected)} selected vertices.` : "The next three work on the whole model; paint a region to limit them."}
      </p>
      <Subdivide disabled={refused !== undefined} />
      <Smooth disabled={refused !== undefined} />
      <Remesh disabled={refused !== undefined} />
    </Section>
  );
}

function Cut({ disabled }: { disabled: boolean }): JSX.Element {
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
    <fieldset disabled={disabled}>
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

function Subdivide({ disabled }: { disabled: boolean }): JSX.Element {
  const [scheme, setScheme] = useState<"LOOP" | "MIDPOINT">("LOOP");
  return (
    <fieldset disabled={disabled}>
      <legend>Subdivide</legend>
      <div class="row">
        <Choice
          label="Scheme"
          value={scheme}
          options={[
            ["LOOP", "smooth"],
            ["MIDPOINT", "midpoint"],
          ]}
          onValue={setScheme}
        />
        <span class="gap" />
        <Button label="Subdivide" onClick={() => void subdivide(scheme)} />
      </div>
    </fieldset>
  );
}

function Smooth({ disabled }: { disabled: boolean }): JSX.Element {
  return (
    <fieldset disabled={disabled}>
      <legend>Smooth</legend>
      <div class="row">
        <span class="gap" />
        <Button label="Relax" onClick={() => void smooth("RELAX")} />
        <Button label="Smooth" onClick={() => void smooth("SMOOTH")} />
      </div>
    </fieldset>
  );
}

function Remesh({ disabled }: { disabled: boolean }): JSX.Element {
  const { remeshLength } = s.settings.value;
  const brushing = s.tool.value === "remesh";
  return (
    <fieldset disabled={disabled}>
      <legend>Remesh</legend>
      <div class="row">
        <Field label="Edge length" hint="In model units; 0 remeshes only where the surface is stretched">
          <NumberInput label="Edge length" value={remeshLength} min={0} digits={5} step={0.01} onValue={(length) => s.choose({ remeshLength: length })} />
        </Field>
        <span class="gap" />
        <Button label="Brush" pressed={brushing} onClick={() => (s.tool.value = brushing ? "orbit" : "remesh")} />
        <Button label="Remesh" onClick={() => void remesh()} />
      </div>
    </fieldset>
  );
}
