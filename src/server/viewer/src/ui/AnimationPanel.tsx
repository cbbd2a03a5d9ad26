/** Animations by a clip: which one, how it is taken, and what all frames together did to the surface. */

import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { animate, animating, animationReport, clipOptions, lastSource, type ClipOptions } from "../app/animating.ts";
import { finding, showRig } from "../app/rigging.ts";
import { wardrobe } from "../app/dressing.ts";
import { pickRecording } from "./files.ts";
import { Button, Facts, Field, NumberInput, Section, Select } from "./parts.tsx";
import { count } from "../model/words.ts";
import { FaultLine } from "./WarningLine.tsx";

const RATES = ["0", "60", "30", "24", "15", "10", "5"] as const;
const FITS = ["-1", "0", "1", "2", "4", "8"] as const;

export function AnimationPanel(): JSX.Element {
  const [chosen, setChosen] = useState(0);
  const clips = wardrobe.value.clips.map(({ name, channels }, k) => ({ name, channels, k })).filter(({ channels }) => channels > 0);
  const clip = clips.find(({ k }) => k === chosen) ?? clips[0];
  const { fps, first, count: wanted, refine } = clipOptions.value;
  const set = (change: Partial<ClipOptions>): void => {
    clipOptions.value = { ...clipOptions.peek(), ...change };
  };
  return (
    <Section title="Animation" note={animating.value?.source.title ?? ""} open={false}>
      {clip === undefined ? (
        <p class="hint">Drop a BVH file on the page to animate the model. A model that is not an upright figure needs a rig (JSON) too.</p>
      ) : (
        <div class="row">
          <Select
            label="Clip to solve"
            value={String(clip.k)}
            options={clips.map(({ name, k }) => [String(k), name] as const)}
            onValue={(value) => setChosen(Number(value))}
          />
          <Button kind="main" label="Animate" onClick={() => void animate({ title: clip.name, own: clip.k })} />
          <span class="gap" />
          <Button icon="open" label="BVH…" onClick={pickRecording} />
        </div>
      )}
      <div class="row">
        {clip === undefined && <Button icon="open" label="BVH…" onClick={pickRecording} />}
        <Button label="Joints…" disabled={finding.value} onClick={() => void showRig(lastSource.value ?? { title: "the next recording" })} />
      </div>
      <Field label="Rate" hint="Frames to solve for each second of the clip">
        <Select
          label="Rate"
          value={(RATES.find((rate) => Number(rate) === fps) ?? "0")}
          options={RATES.map((rate) => [rate, rate === "0" ? "the clip's" : `${rate} a second`] as const)}
          onValue={(value) => set({ fps: Number(value) })}
        />
      </Field>
      <Field label="First frame">
        <NumberInput label="First frame" value={first} step={1} min={0} digits={0} onValue={(value) => set({ first: Math.round(value) })} />
      </Field>
      <Field label="Frames" hint="How many frames to solve; 0: all from the first frame">
        <NumberInput label="Frames" value={wanted} step={1} min={0} digits={0} onValue={(value) => set({ count: Math.round(value) })} />
      </Field>
      <Field label="Refinements" hint="How often the server fits rotations in each frame">
        <Select
          label="Refinements"
          value={FITS.find((fit) => Number(fit) === refine) ?? "-1"}
          options={FITS.map((fit) => [fit, fit === "-1" ? "carried" : fit] as const)}
          onValue={(value) => set({ refine: Number(value) })}
        />
      </Field>
      <Told />
    </Section>
  );
}

/** What the server said of all frames. */
function Told(): JSX.Element | null {
  const report = animationReport.value;
  const totals = report?.totals;
  if (report === undefined || totals === undefined) return null;
  const percent = (x: number): string => `${(x * 100).toFixed(1)} %`;
  return (
    <>
      {report.warnings.map((warning) => (
        <FaultLine key={warning} text={warning} />
      ))}
      <Facts
        rows={[
          ["Frames", `${count(totals.frames)}, ${totals.framesPerSecond.toPrecision(2)} a second`, "As the server solved them"],
          ["Volume", `${percent(totals.volumeChangeMean)}, worst ${percent(totals.volumeChangeWorst)}`, "Mean over all frames, and the frame farthest from the rest pose"],
          ["Edge change", percent(totals.edgeRmsMean), "Root of the mean square of relative edge length change, mean over frames"],
          ["Largest stretch", `× ${totals.maxStretch.toFixed(2)}`],
          ["Flipped triangles", count(totals.flippedTrianglesWorst), "In the worst frame"],
        ]}
      />
    </>
  );
}
