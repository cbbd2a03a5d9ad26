/** The tools, along the left edge. */

import type { JSX } from "preact";
import * as s from "../app/signals.ts";
import type { IconName } from "./icons.tsx";
import { Button } from "./parts.tsx";

/** Tools with their names and keys, in the order in which work goes. */
export const TOOLS: readonly { tool: s.Tool & IconName; name: string; key: string }[] = [
  { tool: "orbit", name: "Orbit", key: "V" },
  { tool: "brush", name: "Paint a region", key: "B" },
  { tool: "box", name: "Select by box", key: "X" },
  { tool: "lasso", name: "Select by lasso", key: "L" },
  { tool: "part", name: "Select a part", key: "C" },
  { tool: "move", name: "Move the handle", key: "G" },
  { tool: "rotate", name: "Rotate the handle", key: "R" },
  { tool: "scale", name: "Scale the handle", key: "S" },
  { tool: "remesh", name: "Remesh brush", key: "M" },
];

export function ToolRail(): JSX.Element {
  const idle = s.doc.value === undefined;
  return (
    <nav class="rail" aria-label="Tools">
      {TOOLS.map(({ tool, name, key }) => (
        <>
          {(tool === "brush" || tool === "move" || tool === "remesh") && <span class="rule" />}
          <Button
            bare
            icon={tool}
            label={name}
            keys={key}
            disabled={idle || (tool === "remesh" && s.editsRefused.value !== undefined)}
            pressed={!idle && s.tool.value === tool}
            onClick={() => (s.tool.value = tool)}
          />
        </>
      ))}
    </nav>
  );
}
