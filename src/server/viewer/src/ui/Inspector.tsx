/** The side panel: what is open, what is held, how it is solved. */

import type { JSX } from "preact";
import { AnimationPanel } from "./AnimationPanel.tsx";
import { EditPanel } from "./EditPanel.tsx";
import { HandlePanel } from "./HandlePanel.tsx";
import { HistoryPanel } from "./HistoryPanel.tsx";
import { ModelPanel } from "./ModelPanel.tsx";
import { SelectionPanel } from "./SelectionPanel.tsx";
import { SolvePanel } from "./SolvePanel.tsx";
import { ViewPanel } from "./ViewPanel.tsx";

export function Inspector(): JSX.Element {
  return (
    <aside class="inspector" aria-label="Properties">
      <SelectionPanel />
      <HandlePanel />
      <ModelPanel />
      <AnimationPanel />
      <SolvePanel />
      <ViewPanel />
      <EditPanel />
      <HistoryPanel />
    </aside>
  );
}
