/** Every edit that the server has. */

import type { ComponentChildren, JSX } from "preact";
import { useState } from "preact/hooks";
import { schema } from "pliant-client";
import { edit, region, remesh } from "../app/editing.ts";
import * as s from "../app/signals.ts";
import { count } from "../model/words.ts";
import { Cut } from "./Cut.tsx";
import { pickModel } from "./files.ts";
import { Line } from "./Line.tsx";
import { Button, Check, Choice, Field, NumberInput, Section, Select } from "./parts.tsx";

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
      <fieldset disabled={refused !== undefined}>
        <Cut />
        <Line />
        <p class="hint">
          {selected > 0
            ? `Triangles and holes are edited at the ${count(selected)} selected vertices, the rest as a whole.`
            : "Edits below work on the whole model; select a region to limit those of triangles and holes."}
        </p>
        <Surface />
        <Holes none={selected === 0} />
        <Parts />
        <OtherModels />
        <WholePose />
      </fieldset>
    </Section>
  );
}

/** Edits of one kind. */
function Group({ title, children }: { title: string; children: ComponentChildren }): JSX.Element {
  return (
    <fieldset>
      <legend>{title}</legend>
      {children}
    </fieldset>
  );
}

/** More, fewer or better triangles. */
function Surface(): JSX.Element {
  const [scheme, setScheme] = useState<"LOOP" | "MIDPOINT">("LOOP");
  const [kept, setKept] = useState(50);
  const { remeshLength } = s.settings.value;
  const brushing = s.tool.value === "remesh";
  const smooth = (what: string, kind: "SMOOTH" | "RELAX") => (): void =>
    void edit(what, { case: "smooth", value: { ...region(), kind: schema.EditRequest_Smooth_Kind[kind] } });
  return (
    <Group title="Triangles">
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
        <Button
          label="Subdivide"
          onClick={() => void edit("Subdividing", { case: "subdivide", value: { ...region(), scheme: schema.EditRequest_Subdivide_Scheme[scheme] } })}
        />
      </div>
      <div class="row">
        <Field label="Keep" hint="The share of triangles that stays, in percent">
          <NumberInput label="Share of triangles to keep" value={kept} min={1} max={99} digits={1} step={5} onValue={setKept} />
        </Field>
        <span>%</span>
        <span class="gap" />
        <Button label="Decimate" onClick={() => void edit("Decimating", { case: "decimate", value: { ...region(), ratio: kept / 100 } })} />
      </div>
      <div class="row">
        <Field label="Edges" hint="Their length in model units; 0 remeshes only where the surface is stretched">
          <NumberInput label="Edge length" value={remeshLength} min={0} digits={5} step={0.01} onValue={(length) => s.choose({ remeshLength: length })} />
        </Field>
        <span class="gap" />
        <Button label="Brush" pressed={brushing} onClick={() => (s.tool.value = brushing ? "orbit" : "remesh")} />
        <Button label="Remesh" onClick={() => void remesh()} />
      </div>
      <div class="row">
        <span class="gap" />
        <Button label="Relax" hint="More even triangles on the same surface" onClick={smooth("Relaxing", "RELAX")} />
        <Button label="Smooth" hint="Takes noise and wrinkles off" onClick={smooth("Smoothing", "SMOOTH")} />
      </div>
    </Group>
  );
}

/** Holes: closed, or made by deleting the selection. */
function Holes({ none }: { none: boolean }): JSX.Element {
  const [cap, setCap] = useState<keyof typeof schema.EditRequest_Cap>("CONTINUED");
  const [fills, setFills] = useState(false);
  return (
    <Group title="Holes">
      <div class="row">
        <Choice
          label="What closes a hole"
          value={cap}
          options={[
            ["CONTINUED", "curved"],
            ["FLAT", "flat"],
          ]}
          onValue={setCap}
        />
        <span class="gap" />
        <Button label="Fill holes" onClick={() => void edit("Filling holes", { case: "fill", value: { ...region(), cap: schema.EditRequest_Cap[cap] } })} />
      </div>
      <div class="row">
        <Check label="Close the hole" checked={fills} onValue={setFills} />
        <span class="gap" />
        <Button
          label="Delete selection"
          disabled={none}
          onClick={() => void edit("Deleting", { case: "delete", value: { ...region(), fill: fills } })}
        />
      </div>
    </Group>
  );
}

/** Vertices that lie together, and parts of the whole model that are too small or copies. */
function Parts(): JSX.Element {
  const diagonal = s.doc.value?.report.diagonal ?? 1;
  const [within, setWithin] = useState<number>();
  const [largest, setLargest] = useState(0);
  const [share, setShare] = useState(1);
  const [size, setSize] = useState(0);
  const [apart, setApart] = useState(0);
  const near = within ?? Number((diagonal / 1e5).toPrecision(1));
  const rules = { keepLargest: largest, smallestShare: share / 100, smallestSize: size, duplicatesWithin: apart };
  return (
    <Group title="Vertices and parts">
      <div class="row">
        <Field label="Distance" hint="Vertices at most this far apart become one, in model units">
          <NumberInput label="Welding distance" value={near} min={1e-12} digits={9} step={near} onValue={setWithin} />
        </Field>
        <span class="gap" />
        <Button label="Weld" onClick={() => void edit("Welding", { case: "weld", value: { tolerance: near } })} />
      </div>
      <Field label="Smallest area" hint="Connected parts with less go, in percent of the largest part's area; 0: none">
        <NumberInput label="Smallest area of a part" value={share} min={0} max={100} digits={4} step={1} onValue={setShare} />
        <span>%</span>
      </Field>
      <Field label="Smallest size" hint="Parts go whose box has a shorter diagonal, in model units; 0: none">
        <NumberInput label="Smallest size of a part" value={size} min={0} digits={9} step={diagonal / 100} onValue={setSize} />
      </Field>
      <Field label="Copies within" hint="Triangles go whose corners are at most this far from those of another, in model units; 0: none">
        <NumberInput label="Distance of copies" value={apart} min={0} digits={9} step={near} onValue={setApart} />
      </Field>
      <div class="row">
        <Field label="Keep at most" hint="How many parts stay, those with the largest area; 0: all">
          <NumberInput label="Parts to keep" value={largest} min={0} digits={0} step={1} onValue={setLargest} />
        </Field>
        <span class="gap" />
        <Button
          label="Clean"
          hint="Removes small parts and hidden copies of the whole model"
          disabled={Object.values(rules).every((rule) => rule === 0)}
          onClick={() => void edit("Cleaning", { case: "clean", value: rules })}
        />
      </div>
    </Group>
  );
}

/** Edits that take another model. */
function OtherModels(): JSX.Element {
  const [how, setHow] = useState<keyof typeof schema.EditRequest_Merge_How>("LOOSE");
  const [inPlace, setInPlace] = useState(true);
  return (
    <Group title="Another model">
      <div class="row">
        <Select
          label="How the models are joined"
          value={how}
          options={[
            ["LOOSE", "separate part"],
            ["WELD", "weld boundaries"],
            ["STITCH", "stitch boundaries"],
          ]}
          onValue={setHow}
        />
        <span class="gap" />
        <Button
          label="Merge…"
          hint="Adds another model to this one"
          onClick={() => pickModel((model, format) => edit("Merging", { case: "merge", value: { source: { case: "model", value: model }, format, how: schema.EditRequest_Merge_How[how] } }))}
        />
      </div>
      <div class="row">
        <Check label="Stay in place" checked={inPlace} onValue={setInPlace} />
        <span class="gap" />
        <Button
          label="Wrap onto…"
          hint="Takes on the shape of a scan or of another model; triangles stay"
          onClick={() => pickModel((model, format) => edit("Wrapping", { case: "wrap", value: { target: { case: "model", value: model }, format, inPlace } }))}
        />
      </div>
    </Group>
  );
}

/** What is done with the pose as a whole. */
function WholePose(): JSX.Element {
  return (
    <Group title="Pose">
      <div class="row">
        <Button label="Resolve crossings" hint="Moves vertices as little as is needed for triangles not to cross" onClick={() => void edit("Resolving crossings", { case: "unintersect", value: {} })} />
        <span class="gap" />
        <Button label="Set as rest pose" hint="Later poses start from this shape" onClick={() => void edit("New rest pose", { case: "adopt", value: {} })} />
      </div>
    </Group>
  );
}
