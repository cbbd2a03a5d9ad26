/** The selection, and what it can become. */

import type { JSX } from "preact";
import { makeHandle } from "../app/handling.ts";
import * as s from "../app/signals.ts";
import { clearSelection, invertSelection } from "../app/tools.ts";
import { selectingMeans } from "./mouse.ts";
import { Button, Check, Field, Section } from "./parts.tsx";
import { count } from "../model/words.ts";

export function SelectionPanel(): JSX.Element {
  const selected = s.selectedCount.value;
  const { brushPixels, throughSelect } = s.settings.value;
  const none = selected === 0;
  return (
    <Section title="Selection" note={none ? "nothing" : count(selected)}>
      {none && (
        <p class="hint">
          Paint, box or lasso the places for a handle. {selectingMeans(s.settings.value.looksWith)}
        </p>
      )}
      <div class="row">
        <Button kind="main" label="Grip" keys="Enter" disabled={none} onClick={() => void makeHandle("grip")} />
        <Button label="Pin" keys="P" disabled={none} onClick={() => void makeHandle("pin")} />
        <Button label="Soft" keys="O" disabled={none} onClick={() => void makeHandle("soft")} />
      </div>
      <div class="row">
        <Button label="Curve" disabled={none} onClick={() => void makeHandle("soft", "curve")} />
        <Button label="Lattice" disabled={none} onClick={() => void makeHandle("soft", "lattice")} />
        <span class="gap" />
        <Button label="Invert" keys="I" onClick={invertSelection} />
        <Button label="Clear" keys="Escape" disabled={none} onClick={clearSelection} />
      </div>
      {(s.tool.value === "brush" || s.tool.value === "remesh") && (
        <Field label="Brush" hint="Radius in pixels; [ and ] change it">
          <input
            type="range"
            min="4"
            max="200"
            value={brushPixels}
            onInput={(event) => s.choose({ brushPixels: Number(event.currentTarget.value) })}
          />
          <output>{brushPixels} px</output>
        </Field>
      )}
      <Check label="Through the model (T)" checked={throughSelect} onValue={(value) => s.choose({ throughSelect: value })} />
    </Section>
  );
}
