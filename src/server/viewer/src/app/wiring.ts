/** Connects signals and scene: made once, when the canvas is there. */

import { computed, effect, untracked } from "@preact/signals";
import type { TransformKind } from "../model/transform.ts";
import { Axes } from "../scene/axes.ts";
import { CuttingPlane } from "../scene/cutting.ts";
import { Gizmo, type GizmoMode } from "../scene/gizmo.ts";
import { Joints } from "../scene/joints.ts";
import { Markers, placeOf } from "../scene/markers.ts";
import { Overlay } from "../scene/overlay.ts";
import { Pointer } from "../scene/pointer.ts";
import { Stage } from "../scene/stage.ts";
import { applyOptions, commitPoses, dragTo, giveUpDrag, turn } from "./dragging.ts";
import { resume, sessionOfThisTab } from "./opening.ts";
import { showLooks } from "./dressing.ts";
import { installAnimating } from "./animating.ts";
import { installCamera } from "./camera.ts";
import { installCrossing } from "./crossing.ts";
import { installFollowing } from "./following.ts";
import { startOf } from "./handling.ts";
import { installIntermission, onScreen } from "./intermission.ts";
import { controlEvents, installLeading } from "./leading.ts";
import { installLines, lineEvents } from "./lines.ts";
import { repaint } from "./painting.ts";
import { installPlaying } from "./playing.ts";
import { installRigging, jointEvents } from "./rigging.ts";
import * as s from "./signals.ts";
import { installSteps } from "./steps.ts";
import { armTool, installTools } from "./tools.ts";
import { installTransforming } from "./transforming.ts";
import { setView, view } from "./view.ts";

const MODES: Readonly<Record<TransformKind, GizmoMode>> = { move: "translate", rotate: "rotate", scale: "scale" };

/** Builds the scene inside `host`. */
export function install(host: HTMLElement, gizmoLabel: HTMLElement): void {
  const stage = new Stage(host);
  const gizmo: Gizmo = new Gizmo(stage, {
    begin: () => {
      s.dragging.value = true;
    },
    change: (pose) => {
      const id = s.activeId.peek();
      if (id !== undefined) dragTo(id, pose);
    },
    end: (pose) => {
      const id = s.activeId.peek();
      s.dragging.value = false;
      if (id !== undefined) {
        dragTo(id, pose);
        void commitPoses([id]);
      }
    },
    giveUp: (pose) => {
      const id = s.activeId.peek();
      s.dragging.value = false;
      if (id !== undefined) void giveUpDrag(id, pose);
    },
  });
  const plane = new CuttingPlane(stage);
  setView({ stage, gizmo, axes: new Axes(stage), markers: new Markers(stage), joints: new Joints(stage, jointEvents), controls: new Joints(stage, controlEvents), line: new Joints(stage, lineEvents), overlay: new Overlay(host), pointer: new Pointer(stage) });
  installTools();
  installSteps();
  installTransforming();
  stage.beforePaint(turn);
  installPlaying();
  installAnimating();
  installIntermission();
  installFollowing();
  installCamera();
  installCrossing();
  installRigging();
  installLeading();
  installLines();
  stage.beforePaint(() => followGizmo(gizmoLabel));

  const dark = matchMedia("(prefers-color-scheme: dark)");
  const applyTheme = (): void => {
    const { theme } = s.settings.value;
    const look = theme === "auto" ? (dark.matches ? "dark" : "light") : theme;
    document.documentElement.dataset["theme"] = look;
    untracked(() => stage.setLook(look));
  };
  effect(applyTheme);
  dark.addEventListener("change", applyTheme);
  effect(() => armTool(s.tool.value, s.settings.value.looksWith));
  effect(() => {
    const { tolerance, maxError, progressive, encoding, window, firstPass, method, refineDragging, refineCommit } = s.settings.value;
    void [tolerance, maxError, progressive, encoding, window, firstPass, method, refineDragging, refineCommit];
    untracked(applyOptions);
  });
  effect(() => {
    // Read first: a signal that is not read is not watched.
    const { wire } = s.settings.value;
    if (s.doc.value !== undefined) for (const surface of stage.surfaces()) surface.setWire(wire);
    stage.request();
  });
  effect(() => {
    void [s.settings.value.colouring, s.selection.value, regions.value, s.activeId.value, s.doc.value];
    untracked(repaint);
  });
  effect(() => {
    void [s.settings.value.colouring, s.settings.value.materials];
    untracked(showLooks);
  });
  effect(() => {
    const handle = s.activeHandle.value;
    const kind = kindOf(s.tool.value);
    if (kind !== undefined) gizmo.setMode(MODES[kind], s.settings.value.localAxes);
    const holds = handle !== undefined && handle.hold !== "pin" && handle.guide === undefined && kind !== undefined && onScreen.value === undefined;
    if (holds) gizmo.attach(handle.pivot, untracked(() => startOf(handle, kind)));
    else gizmo.attach(undefined, undefined);
  });
  effect(() => view().markers.show(onScreen.value === undefined ? s.handles.value : []));
  effect(() => plane.show(s.cutPlane.value));
  void resumeThisTab();
}

/** What a tool does to a handle, if it does something. */
function kindOf(tool: s.Tool): TransformKind | undefined {
  return tool in MODES ? (tool as TransformKind) : undefined;
}

/** What the regions look like; the same as before while only poses change. */
const regions = computed<readonly unknown[]>(() => {
  const now = s.handles.value.flatMap(({ id, vertices, hold, hue }) => [id, vertices, hold, hue]);
  const same = now.length === lastRegions.length && now.every((x, k) => x === lastRegions[k]);
  if (!same) lastRegions = now;
  return lastRegions;
});
let lastRegions: readonly unknown[] = [];

async function resumeThisTab(): Promise<void> {
  const id = sessionOfThisTab();
  if (id !== undefined) await resume(id);
}

/** Keeps the label with the turn counter beside the gizmo. */
function followGizmo(label: HTMLElement): void {
  const { stage } = view();
  const handle = s.activeHandle.peek();
  const at = handle === undefined ? undefined : stage.project(placeOf(handle));
  if (at !== undefined) label.style.transform = `translate(${Math.round(at.x + 22)}px, ${Math.round(at.y + 22)}px)`;
}
