/** The whole interface: bars and panels around the canvas, and what lies over it. */

import type { JSX } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import { AnimationBar, Panes } from "./AnimationBar.tsx";
import { openDropped } from "./files.ts";
import { RigBar } from "./RigBar.tsx";
import { leavingQuestion } from "../app/leaving.ts";
import { installProbe } from "../app/probe.ts";
import * as s from "../app/signals.ts";
import { install } from "../app/wiring.ts";
import { Dialogs } from "./Dialogs.tsx";
import { GizmoLabel } from "./GizmoLabel.tsx";
import { Help } from "./Help.tsx";
import { Inspector } from "./Inspector.tsx";
import { installKeys } from "./keys.ts";
import { LeavingDialog } from "./LeavingDialog.tsx";
import { Notes } from "./Notes.tsx";
import { Start } from "./Start.tsx";
import { StatusBar } from "./StatusBar.tsx";
import { ToolRail } from "./ToolRail.tsx";
import { TopBar } from "./TopBar.tsx";
import { TokenDialog } from "./TokenDialog.tsx";
import { Transport } from "./Transport.tsx";
import { ViewCorner } from "./ViewCorner.tsx";

export function App(): JSX.Element {
  const host = useRef<HTMLDivElement>(null);
  const label = useRef<HTMLDivElement>(null);
  const [failure, setFailure] = useState<string>();
  useEffect(() => {
    if (host.current === null || label.current === null) return;
    try {
      install(host.current, label.current);
    } catch (error) {
      setFailure(error instanceof Error ? error.message : String(error));
      return;
    }
    installKeys();
    installProbe();
  }, []);
  const isOpen = s.doc.value !== undefined;
  return (
    <div class={`page${isOpen ? "" : " blank"}`}>
      <TopBar />
      <ToolRail />
      <main class="stage" aria-busy={s.busy.value !== undefined}>
        <div class="canvas" ref={host} />
        <div class="gizmo-label" ref={label}>
          <GizmoLabel />
        </div>
        {failure === undefined ? !isOpen && s.busy.value === undefined && <Start /> : <NoGraphics reason={failure} />}
        <Dialogs />
        {isOpen && <Panes />}
        {isOpen && <Transport />}
        {isOpen && <AnimationBar />}
        {isOpen && <RigBar />}
        {isOpen && <ViewCorner />}
        <Notes />
        <DropTarget />
      </main>
      {isOpen && <Inspector />}
      <StatusBar />
      <Help />
      <TokenDialog />
      <LeavingDialog />
    </div>
  );
}

function NoGraphics({ reason }: { reason: string }): JSX.Element {
  return (
    <div class="card" role="alert">
      <h1>This browser cannot draw here</h1>
      <p>The page needs WebGL 2, which is switched off or missing: {reason}</p>
      <p>
        The service itself is not affected; <a href="/openapi.json">its calls</a> work without a browser.
      </p>
    </div>
  );
}

/** Takes files that are dropped anywhere on the page. */
function DropTarget(): JSX.Element | null {
  const [over, setOver] = useState(false);
  useEffect(() => {
    let depth = 0;
    const withFiles = (event: DragEvent): boolean => event.dataTransfer?.types.includes("Files") ?? false;
    const enter = (event: DragEvent): void => {
      if (!withFiles(event)) return;
      depth += 1;
      setOver(true);
    };
    const leave = (): void => {
      depth = Math.max(0, depth - 1);
      if (depth === 0) setOver(false);
    };
    const hover = (event: DragEvent): void => {
      if (withFiles(event)) event.preventDefault();
    };
    const drop = (event: DragEvent): void => {
      depth = 0;
      setOver(false);
      if (!withFiles(event)) return;
      event.preventDefault();
      // Another file does not act behind the question that one asked.
      if (leavingQuestion.peek() !== undefined) return;
      if (event.dataTransfer !== null) void openDropped(event.dataTransfer);
    };
    addEventListener("dragenter", enter);
    addEventListener("dragleave", leave);
    addEventListener("dragover", hover);
    addEventListener("drop", drop);
    return () => {
      removeEventListener("dragenter", enter);
      removeEventListener("dragleave", leave);
      removeEventListener("dragover", hover);
      removeEventListener("drop", drop);
    };
  }, []);
  return over ? <div class="drop">Drop to open</div> : null;
}
