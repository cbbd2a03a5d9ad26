/** How the model is shown, and what the last commit did to it. */

import type { JSX } from "preact";
import { crossings } from "../app/crossing.ts";
import * as s from "../app/signals.ts";
import { wardrobe } from "../app/dressing.ts";
import { FULL_STRETCH } from "../model/stretch.ts";
import { buttonsMean } from "./mouse.ts";
import { Check, Choice, Facts, Field, Section } from "./parts.tsx";
import { count } from "../model/words.ts";

export function ViewPanel(): JSX.Element {
  const { colouring, wire, localAxes, looksWith, materials } = s.settings.value;
  const quality = s.quality.value;
  return (
    <Section title="View">
      <Field label="Colours">
        <Choice
          label="Colours"
          value={colouring}
          options={[
            ["handles", "handles"],
            ["stretch", "stretch"],
            ["crossings", "crossings"],
            ["plain", "plain"],
          ]}
          onValue={(value) => s.choose({ colouring: value })}
        />
      </Field>
      {colouring === "stretch" && (
        <div class="legend" aria-label="Blue: edges are shorter than in the rest pose; orange: longer">
          <span class="ramp" />
          <div>
            <span>÷ {FULL_STRETCH}</span>
            <span>as in the rest pose</span>
            <span>× {FULL_STRETCH}</span>
          </div>
        </div>
      )}
      {colouring === "crossings" && <Crossings />}
      <Field label="Orbit with" hint={buttonsMean(looksWith)}>
        <Choice
          label="The button that orbits"
          value={looksWith}
          options={[
            ["middle", "middle button"],
            ["right", "right button"],
          ]}
          onValue={(value) => s.choose({ looksWith: value })}
        />
      </Field>
      <div class="row">
        <Check
          label="Materials (U)"
          checked={materials && wardrobe.value.dressed}
          disabled={!wardrobe.value.dressed}
          onValue={(value) => s.choose({ materials: value })}
        />
        <Check label="Wire (W)" checked={wire} onValue={(value) => s.choose({ wire: value })} />
        <Check label="Own axes (A)" checked={localAxes} onValue={(value) => s.choose({ localAxes: value })} />
      </div>
      {quality && (
        <Facts
          rows={[
            ["Edge change", percent(quality.edgeRms), "Root of the mean square of relative edge length change"],
            quality.openSurface ? ["Volume", "n/a", "The surface is open, so it encloses none"] : ["Volume", signed(quality.volumeChange)],
            ["Area", signed(quality.areaChange)],
            ["Largest stretch", `× ${quality.maxStretch.toFixed(2)}`],
            ["Flipped triangles", String(quality.flippedTriangles)],
          ]}
        />
      )}
    </Section>
  );
}

/** How many triangles cross others. */
function Crossings(): JSX.Element {
  const found = crossings.value;
  if (found === undefined) return <p class="hint">Crossings are those of the recorded pose.</p>;
  const { total, totalAtRest } = found;
  return (
    <p class="hint crossings" role="status">
      <span class="now">{total === 0 ? "no triangle crosses" : total === 1 ? "1 triangle crosses" : `${count(total)} triangles cross`} another since the rest pose</span>
      {totalAtRest > 0 && <span class="before">{count(totalAtRest)} cross at rest, too</span>}
    </p>
  );
}

function percent(x: number): string {
  return `${(x * 100).toFixed(2)} %`;
}

function signed(x: number): string {
  return `${x > 0 ? "+" : x < 0 ? "−" : ""}${percent(Math.abs(x))}`;
}
