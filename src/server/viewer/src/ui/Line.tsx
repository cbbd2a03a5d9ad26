/** A line on the surface: how it is drawn, and what it becomes. */

import type { JSX } from "preact";
import { applyLine, isLine, lineChoice, linePoints, removeLastPoint } from "../app/lines.ts";
import * as s from "../app/signals.ts";
import { Button, Check, Choice, Field } from "./parts.tsx";

export function Line(): JSX.Element {
  const drawing = s.tool.value === "line";
  const { cuts, closed, keep, fill } = lineChoice.value;
  const choose = (part: Partial<typeof lineChoice.value>): void => {
    lineChoice.value = { ...lineChoice.peek(), ...part };
  };
  return (
    <fieldset>
      <legend>Line on the surface</legend>
      {!drawing && (
        <div class="row">
          <Button label="Draw a line" hint="Cuts along it, or makes edges of it" onClick={() => (s.tool.value = "line")} />
        </div>
      )}
      {drawing && (
        <>
          <p class="hint">Click the surface for each point; drag points to move them.</p>
          <Field label="It becomes">
            <Choice
              label="What the line becomes"
              value={cuts ? "cut" : "edges"}
              options={[
                ["edges", "edges"],
                ["cut", "a cut"],
              ]}
              onValue={(value) => choose({ cuts: value === "cut" })}
            />
          </Field>
          {cuts && (
            <Field label="Keep" hint="Seen from outside, along the line">
              <Choice
                label="Which sides of the line stay"
                value={keep}
                options={[
                  ["BOTH", "both"],
                  ["ABOVE", "left"],
                  ["BELOW", "right"],
                ]}
                onValue={(value) => choose({ keep: value })}
              />
            </Field>
          )}
          <div class="row">
            <Check label="Closed line" checked={closed} onValue={(value) => choose({ closed: value })} />
            {cuts && <Check label="Close the cut" checked={fill} onValue={(value) => choose({ fill: value })} />}
          </div>
          <div class="row">
            <Button label="Remove last" keys="Backspace" disabled={linePoints.value.length === 0} onClick={removeLastPoint} />
            <span class="gap" />
            <Button label="Cancel" keys="Escape" onClick={() => (s.tool.value = "orbit")} />
            <Button kind="main" label={cuts ? "Cut along it" : "Make edges"} keys="Enter" disabled={!isLine()} onClick={() => void applyLine()} />
          </div>
        </>
      )}
    </fieldset>
  );
}
