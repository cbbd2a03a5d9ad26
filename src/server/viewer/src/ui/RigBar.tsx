/** The rig that is shown, at the foot of the canvas: how sure its joints are, and what can be done with it. */

import type { JSX } from "preact";
import { animate } from "../app/animating.ts";
import * as r from "../app/rigging.ts";
import { Button, things } from "./parts.tsx";

export function RigBar(): JSX.Element | null {
  const shown = r.rigging.value;
  if (shown === undefined) return null;
  const { source, joints, rig, own, movable } = shown;
  const doubtful = joints.filter((joint) => joint.doubtful).sort((a, b) => (a.score ?? 1) - (b.score ?? 1));
  const given = joints.filter((joint) => joint.given).length;
  const unsure = doubtful.length > 0;
  return (
    <div class="transport open animation rig" role="group" aria-label="Rig">
      <div class="row">
        <span class="reasons" role="status">
          {things(joints.length, "joint")}
          {own ? " of the rig file" : unsure ? `, ${doubtful.length} uncertain` : ", all certain"}
          {given > 0 && `, ${given} placed by hand`}
          {r.finding.value && " · searching again"}
        </span>
        <span class="gap" />
        {source.bvh !== undefined && (
          <Button
            kind="main"
            label="Animate"
            disabled={unsure || r.finding.value}
            onClick={() => void animate({ ...source, rig })}
          />
        )}
        <Button label="Reset joints" disabled={given === 0 || r.finding.value} onClick={() => void r.forgetCorrections()} />
        <Button bare icon="close" label="Back to editing" keys="Escape" onClick={r.closeRig} />
      </div>
      {unsure && (
        <ul class="doubts">
          {[...reasonsOf(doubtful)].map(([reason, names]) => (
            <li key={reason}>
              <b>{names.join(", ")}</b> {reason}
            </li>
          ))}
        </ul>
      )}
      <p class="hint">
        {movable
          ? "Drag red joints to where they belong, or click those that are right. Blue ones were placed by hand."
          : "These are the joints of the model's own skin."}
      </p>
    </div>
  );
}

/** Joints by what speaks against them. */
function reasonsOf(doubtful: readonly r.RigJoint[]): ReadonlyMap<string, string[]> {
  const names = new Map<string, string[]>();
  for (const { name, reason, score } of doubtful) {
    const why = `${score?.toFixed(2)}: ${reason}`;
    names.set(why, [...(names.get(why) ?? []), name]);
  }
  return names;
}
