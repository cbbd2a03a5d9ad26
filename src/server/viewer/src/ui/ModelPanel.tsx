/** What was opened, and what the server and the page noticed about it. */

import type { schema } from "pliant-client";
import type { JSX } from "preact";
import * as s from "../app/signals.ts";
import { wardrobe } from "../app/dressing.ts";
import { Facts, Section, bytes, things } from "./parts.tsx";
import { count } from "../model/words.ts";
import { FaultLine, WarningLine } from "./WarningLine.tsx";

type Row = [name: string, value: string, meaning: string];

/** What holds the parts of a model together, where there are several. */
function partRows(parts: number, solver: schema.SolverFacts | undefined): Row[] {
  if (parts < 2 || solver === undefined) return [];
  const loose = solver.loose.map((part) => `${part.name || `part ${part.component}`}, ${count(part.vertices)} vertices`);
  return [
    ["Ties", count(solver.ties), "Edges that hold parts together where they touch"],
    ["Loose parts", count(solver.looseParts), loose.length > 0 ? `Joined to nothing: ${loose.join("; ")}` : "Joined to nothing"],
  ];
}

export function ModelPanel(): JSX.Element | null {
  const open = s.doc.value;
  const facts = s.facts.value;
  if (open === undefined || facts === undefined) return null;
  const { report } = open;
  const { model, solver } = facts;
  const { faults } = wardrobe.value;
  const noticed = facts.warnings.length + faults.length;
  const inner = (solver?.graphVertices ?? 0) - (solver?.solverVertices ?? 0);
  const built = Object.values(facts.buildMs).reduce((sum, ms) => sum + ms, 0);
  return (
    <Section title="Model" note={noticed > 0 ? things(noticed, "warning") : (model?.format ?? "")}>
      {facts.warnings.map((warning) => (
        <WarningLine key={`${facts.id} ${warning.code} ${warning.where}`} warning={warning} />
      ))}
      {faults.map((fault) => (
        <FaultLine key={fault} text={fault} />
      ))}
      <Facts
        rows={[
          ["Vertices", count(model?.vertices), "Render vertices: those of the file"],
          ["Triangles", count(model?.triangles)],
          ["Primitives", count(facts.primitives.length)],
          ["Seam vertices", count(report.seamVertices), "Vertices at the same place as another; the solver takes them as one"],
          ["Parts", count(report.parts.length), "Connected pieces"],
          ...partRows(report.parts.length, solver),
          ["Inner nodes", inner > 0 ? count(inner) : "none", "Nodes inside that keep the volume"],
          ["Graph", `${count(solver?.graphVertices)} · ${count(solver?.graphEdges)}`, "Vertices and edges that the solver works on"],
          ["Levels", (solver?.levels ?? []).map(({ vertices }) => count(vertices)).join(" › "), "The multigrid hierarchy"],
          ["Memory", bytes(solver?.bytes), "Server memory of this session"],
          ["File", bytes(model?.bytes)],
          ["Build", `${built.toFixed(0)} ms`, Object.entries(facts.buildMs).map(([stage, ms]) => `${stage} ${ms.toFixed(1)} ms`).join(", ")],
        ]}
      />
    </Section>
  );
}
