/** How poses are solved and how the session is built. */

import type { JSX } from "preact";
import { canRebuild, rebuild } from "../app/opening.ts";
import * as s from "../app/signals.ts";
import { Button, Check, Choice, Field, NumberInput, Section, Select } from "./parts.tsx";

/** Session options that the open session was built with; others wait for a rebuild. */
const BUILD_KEYS = ["volumeMode", "volumeInterval", "components"] as const;

export function SolvePanel(): JSX.Element {
  const chosen = s.settings.value;
  const { choose } = s;
  return (
    <>
      <Section title="Solving" open={false}>
        <Field label="Refine, dragging" hint="Rotation re-fits after the second pass; 0 is the paper's two passes">
          <NumberInput label="Refine while dragging" value={chosen.refineDragging} min={0} max={50} step={1} digits={0} onValue={(refineDragging) => choose({ refineDragging })} />
        </Field>
        <Field label="Refine, release" hint="Re-fits when a drag is recorded">
          <NumberInput label="Refine on release" value={chosen.refineCommit} min={0} max={50} step={1} digits={0} onValue={(refineCommit) => choose({ refineCommit })} />
        </Field>
        <Field label="Tolerance" hint="Relative residual to reach">
          <Select
            label="Tolerance"
            value={String(chosen.tolerance)}
            options={[
              ["0.001", "1e-3"],
              ["0.0001", "1e-4"],
              ["0.00001", "1e-5"],
              ["0.000001", "1e-6"],
            ]}
            onValue={(value) => choose({ tolerance: Number(value) })}
          />
        </Field>
        <Field label="Stop at error" hint="Instead of the tolerance: the largest error, as a share of the box's diagonal">
          <Select
            label="Stop at error"
            value={String(chosen.maxError)}
            options={[
              ["0", "by tolerance"],
              ["0.001", "0.1 %"],
              ["0.0001", "0.01 %"],
              ["0.00001", "0.001 %"],
            ]}
            onValue={(value) => choose({ maxError: Number(value) })}
          />
        </Field>
        <Field label="First pass">
          <Select
            label="First pass"
            value={chosen.firstPass}
            options={[
              ["HARMONIC", "harmonic"],
              ["DIFFUSION", "diffusion"],
              ["LINEAR_FRAMES", "linear frames"],
            ]}
            onValue={(firstPass) => choose({ firstPass })}
          />
        </Field>
        <Field label="Method">
          <Select
            label="Method"
            value={chosen.method}
            options={[
              ["GRAPH", "two-pass graph"],
              ["SPATIAL_RBF", "spatial RBF"],
            ]}
            onValue={(method) => choose({ method })}
          />
        </Field>
        <Field label="Frames" hint="16-bit frames are half as large, differences are smaller still; exact to 1/65535 of the box">
          <Choice
            label="Frame encoding"
            value={chosen.encoding}
            options={[
              ["AUTO", "auto"],
              ["F32", "32 bit"],
              ["U16", "16 bit"],
              ["DELTA", "differences"],
            ]}
            onValue={(encoding) => choose({ encoding })}
          />
        </Field>
        <Field label="Window" hint="Unacknowledged frames that the server may send">
          <NumberInput label="Window" value={chosen.window} min={1} max={s.facts.value?.limits?.window ?? 8} step={1} digits={0} onValue={(window) => choose({ window })} />
        </Field>
        <Check label="Progressive" checked={chosen.progressive} onValue={(progressive) => choose({ progressive })} />
      </Section>
      <Section title="Volume and parts" open={false}>
        <Field label="Inner nodes" hint="Nodes inside closed parts that keep the volume">
          <Choice
            label="Volume graph"
            value={chosen.volumeMode}
            options={[
              ["AUTO", "auto"],
              ["OFF", "off"],
              ["REQUIRED", "always"],
            ]}
            onValue={(volumeMode) => choose({ volumeMode })}
          />
        </Field>
        <Field label="Interval" hint="Lattice interval in model units; 0 lets the server choose">
          <NumberInput label="Lattice interval" value={chosen.volumeInterval} min={0} step={0.01} digits={5} onValue={(volumeInterval) => choose({ volumeInterval })} />
        </Field>
        <Field label="Loose parts" hint="What the server does with parts without a handle">
          <Select
            label="Parts without a handle"
            value={chosen.components}
            options={[
              ["FOLLOW", "follow the nearest"],
              ["HOLD", "stay"],
              ["FREE", "reject"],
            ]}
            onValue={(components) => choose({ components })}
          />
        </Field>
        <p class="hint">These apply when you open a model. {canRebuild() ? "" : "This session was opened elsewhere."}</p>
        <div class="row">
          <Button label="Build again" disabled={!canRebuild()} onClick={() => void rebuild()} />
          <span class="gap" />
          <Button
            label="Defaults"
            disabled={BUILD_KEYS.every((key) => chosen[key] === s.DEFAULTS[key])}
            onClick={() => choose({ volumeMode: "AUTO", volumeInterval: 0, components: "FOLLOW" })}
          />
        </div>
      </Section>
    </>
  );
}
