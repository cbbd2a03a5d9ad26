/** The handles, and the one that is active in full. */

import type { Vector } from "pliant-client";
import type { JSX } from "preact";
import { asItLies, changeHandle, keepHardParts, poseHandle, removeHandle } from "../app/handling.ts";
import * as s from "../app/signals.ts";
import { activate } from "../app/tools.ts";
import { lengthStep } from "../app/transforming.ts";
import { AT_REST, type HandleState, colourOf, isAtRest } from "../model/handles.ts";
import { TurnCount } from "./GizmoLabel.tsx";
import { Icon } from "./icons.tsx";
import { Button, Check, Choice, Field, NumberInput, Section } from "./parts.tsx";
import { count } from "../model/words.ts";

export function HandlePanel(): JSX.Element {
  const list = s.handles.value;
  const active = s.activeHandle.value;
  return (
    <Section title="Handles" note={list.length === 0 ? "none" : String(list.length)}>
      {list.length === 0 && <p class="hint">A model bends between handles: pin what stays, grip what moves.</p>}
      {list.length === 1 && active?.guide === undefined && <p class="hint">With one handle the whole model follows it. Pin a second place.</p>}
      <ul class="handles">
        {list.map((handle) => (
          <HandleRow key={handle.id} handle={handle} active={handle === active} />
        ))}
      </ul>
      {active && <Details handle={active} />}
      {list.length > 0 && (s.doc.value?.report.parts.length ?? 0) > 1 && (
        <Check
          label="Hard parts stay rigid"
          checked={(s.facts.value?.solver?.stiffParts ?? 0) > 0}
          onValue={(stiff) => void keepHardParts(stiff)}
        />
      )}
    </Section>
  );
}

function HandleRow({ handle, active }: { handle: HandleState; active: boolean }): JSX.Element {
  const { id, name, hold } = handle;
  const [r, g, b] = colourOf(handle);
  return (
    <li class={active ? "active" : ""}>
      <button type="button" aria-pressed={active} onClick={() => activate(id)}>
        <span class="swatch" ref={(element) => element?.style.setProperty("background", `rgb(${r} ${g} ${b})`)} />
        <span class="name">{name}</span>
        {hold === "pin" && <Icon name="pin" />}
        <span class="count">{count(handle.count)}</span>
      </button>
      <Button bare icon="trash" label={`Remove ${name}`} onClick={() => void removeHandle(id)} />
    </li>
  );
}

function Details({ handle }: { handle: HandleState }): JSX.Element {
  const { id } = handle;
  const change = (part: Partial<HandleState>): void => void changeHandle(id, part);
  return (
    <div class="details">
      <Field label="Name">
        <input type="text" value={handle.name} maxLength={40} onChange={(event) => change({ name: event.currentTarget.value || id })} />
      </Field>
      {handle.guide === undefined ? <Held handle={handle} change={change} /> : <Led handle={handle} change={change} />}
    </div>
  );
}

interface Changing {
  readonly handle: HandleState;
  readonly change: (part: Partial<HandleState>) => void;
}

/** A handle that a curve or a lattice leads. */
function Led({ handle, change }: Changing): JSX.Element {
  const { id, pose, guide, stiffness } = handle;
  return (
    <>
      <p class="hint">Drag the points of its {guide?.kind}; the vertices follow them.</p>
      <Stiffness value={stiffness} change={change} />
      <div class="row">
        <span class="gap" />
        <Button icon="reset" label="Reset" disabled={isAtRest(pose)} onClick={() => void poseHandle(id, AT_REST)} />
      </div>
    </>
  );
}

function Stiffness({ value, change }: { value: number; change: Changing["change"] }): JSX.Element {
  return (
    <Field label="Stiffness" hint="How strongly it pulls, in units of edge weights">
      <NumberInput label="Stiffness" value={value} min={1e-6} step={0.5} onValue={(stiffness) => change({ stiffness })} />
    </Field>
  );
}

function Held({ handle, change }: Changing): JSX.Element {
  const { hold, stiffness, falloff, constrains, rigid } = handle;
  const foreign = handle.vertices === undefined;
  return (
    <>
      <Choice
        label="How it holds"
        value={hold}
        options={[
          ["grip", "Grip"],
          ["pin", "Pin"],
          ["soft", "Soft"],
        ]}
        onValue={(value) => change(value === "pin" ? { hold: value, pose: AT_REST } : { hold: value })}
      />
      {foreign && <p class="hint">Set elsewhere: this page knows its pose, not its region.</p>}
      {hold === "soft" && (
        <Stiffness value={stiffness} change={change} />
      )}
      <Field label="Falloff" hint={hold === "soft" ? "How its pull falls around the region" : "How it gives way inside, up to its border"}>
        <select
          aria-label="Falloff"
          value={falloff.kind}
          onChange={(event) => change({ falloff: { ...falloff, kind: event.currentTarget.value as HandleState["falloff"]["kind"] } })}
        >
          <option value="NONE">none</option>
          <option value="LINEAR">linear</option>
          <option value="SMOOTH">smooth</option>
        </select>
        {falloff.kind !== "NONE" && (
          <NumberInput
            label="Falloff radius in model units"
            value={falloff.radius}
            min={1e-9}
            digits={4}
            step={falloff.radius / 10 || 0.1}
            onValue={(radius) => change({ falloff: { ...falloff, radius } })}
          />
        )}
      </Field>
      <fieldset class="row">
        <legend>Holds</legend>
        {(["position", "rotation", "scale"] as const).map((what) => (
          <Check
            label={what}
            checked={constrains[what]}
            // Something must be held.
            disabled={constrains[what] && Object.values(constrains).filter(Boolean).length === 1}
            onValue={(value) => change({ constrains: { ...constrains, [what]: value } })}
          />
        ))}
        <Check label="rigid" checked={rigid} onValue={(value) => change({ rigid: value })} />
      </fieldset>
      {hold !== "pin" && <Pose handle={handle} />}
    </>
  );
}

const AXES = ["X", "Y", "Z"] as const;
const DEGREES = 180 / Math.PI;

function Pose({ handle }: { handle: HandleState }): JSX.Element {
  const { id, pose, constrains } = handle;
  const set = (part: Partial<HandleState["pose"]>): void => void poseHandle(id, { ...pose, ...part });
  const row = (name: string, values: Vector, step: number, digits: number, min: number | undefined, onVector: (next: Vector) => void): JSX.Element => (
    <div class="vector" role="group" aria-label={name}>
      <span>{name}</span>
      {AXES.map((axis, k) => (
        <label class={`axis-${axis.toLowerCase()}`}>
          <span>{axis}</span>
          <NumberInput
            label={`${name} ${axis}`}
            value={values[k] ?? 0}
            step={step}
            digits={digits}
            {...(min === undefined ? {} : { min })}
            onValue={(value) => {
              const next: [number, number, number] = [...values];
              next[k] = value;
              onVector(next);
            }}
          />
        </label>
      ))}
    </div>
  );
  const scaled = (v: Vector, by: number): Vector => [v[0] * by, v[1] * by, v[2] * by];
  const angle = Math.hypot(...pose.rotation);
  return (
    <>
      {row("Move", pose.translation, lengthStep(), 4, undefined, (translation) => set({ translation }))}
      {row("Turn °", scaled(pose.rotation, DEGREES), 5, 1, undefined, (degrees) => set({ ...asItLies(handle), rotation: scaled(degrees, 1 / DEGREES) }))}
      <Check
        label="Turns automatically"
        checked={pose.freely}
        disabled={!constrains.position || !constrains.rotation}
        onValue={(freely) => set(freely ? { freely } : asItLies(handle))}
      />
      {row("Scale", pose.scale, 0.05, 3, 0.01, (scale) => set({ scale }))}
      <div class="row">
        <span class="hint">
          total turn {Math.round(angle * DEGREES)}° <TurnCount angle={angle} />
        </span>
        <span class="gap" />
        <Button icon="reset" label="Reset" disabled={isAtRest(pose)} onClick={() => set(AT_REST)} />
      </div>
    </>
  );
}
