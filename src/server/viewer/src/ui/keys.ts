/** Keyboard shortcuts. The help sheet shows this list, so that both agree. */

import { animating, seekFrame } from "../app/animating.ts";
import { makeHandle, removeHandle } from "../app/handling.ts";
import { bringBack, onScreen } from "../app/intermission.ts";
import { leavingQuestion } from "../app/leaving.ts";
import { applyLine, removeLastPoint } from "../app/lines.ts";
import { redo, undo } from "../app/past.ts";
import * as s from "../app/signals.ts";
import { activate, clearSelection, giveUpGesture, invertSelection } from "../app/tools.ts";
import { beginTransform, transformKey } from "../app/transforming.ts";
import { view } from "../app/view.ts";
import { exportModel, pickFiles } from "./files.ts";
import { nextTheme } from "./TopBar.tsx";
import { TOOLS } from "./ToolRail.tsx";
import { togglePlay } from "./Transport.tsx";

export interface Shortcut {
  /** As shown; `Ctrl` also stands for the Command key. */
  readonly keys: string;
  readonly what: string;
  readonly act: () => void;
  /** Whether it works without a model. */
  readonly always?: boolean;
}

/** Radians and factor that one press of a key looks around by. */
const AROUND = Math.PI / 18;
const NEARER = 1.15;

const removeActive = (): void => {
  if (removeLastPoint() || s.tool.peek() === "line") return;
  const id = s.activeId.peek();
  if (id !== undefined) void removeHandle(id);
};

const wider = (factor: number) => (): void => {
  const { brushPixels } = s.settings.peek();
  s.choose({ brushPixels: Math.round(Math.min(200, Math.max(4, brushPixels * factor))) });
};

const escape = (): void => {
  if (s.helpOpen.peek()) s.helpOpen.value = false;
  else if (giveUpGesture()) return;
  else if (onScreen.peek() !== undefined) bringBack();
  else if (s.cutPlane.peek() !== undefined) s.cutPlane.value = undefined;
  else if (s.tool.peek() === "line") s.tool.value = "orbit";
  else clearSelection();
};

/** Makes the next or the previous handle the active one. */
const step = (by: number) => (): void => {
  const list = s.handles.peek().filter(({ hold }) => hold !== "pin");
  const at = list.findIndex(({ id }) => id === s.activeId.peek());
  if (list.length > 0) activate(list.at((at + by) % list.length)?.id);
};

/** Steps through the frames of an animation; looks around the model while there is none. */
const aside = (by: number) => (): void => {
  const shown = animating.peek();
  if (shown === undefined) view().stage.circle(by * AROUND, 0, 1);
  else seekFrame(shown.at + by);
};

export const SHORTCUTS: readonly { title: string; list: readonly Shortcut[] }[] = [
  {
    title: "Tools",
    list: TOOLS.map(({ tool, name, key }) => ({
      keys: key,
      what: name,
      act: () => {
        if (tool === "move" || tool === "rotate" || tool === "scale") beginTransform(tool);
        else s.tool.value = tool;
      },
    })),
  },
  {
    title: "Selection and handles",
    list: [
      { keys: "Enter", what: "Make a grip of the selection; apply a line", act: () => void (s.tool.peek() === "line" ? applyLine() : makeHandle("grip")) },
      { keys: "P", what: "Pin the selection", act: () => void makeHandle("pin") },
      { keys: "O", what: "Make a soft handle of the selection", act: () => void makeHandle("soft") },
      { keys: "I", what: "Invert the selection", act: invertSelection },
      { keys: "[", what: "Smaller brush", act: wider(1 / 1.2) },
      { keys: "]", what: "Larger brush", act: wider(1.2) },
      { keys: "T", what: "Select through the model", act: () => s.choose({ throughSelect: !s.settings.peek().throughSelect }) },
      { keys: "N", what: "Next handle", act: step(1) },
      { keys: "Delete", what: "Remove the active handle; the last point of a line", act: removeActive },
      { keys: "Escape", what: "Cancel the drag or the stroke, clear the selection, close the sheet", act: escape, always: true },
    ],
  },
  {
    title: "Model",
    list: [
      { keys: "Ctrl+O", what: "Open a model", act: pickFiles, always: true },
      { keys: "Ctrl+S", what: "Export GLB", act: () => void exportModel("glb") },
      { keys: "Ctrl+Z", what: "Undo the last commit, selection, choice of a handle or point of a line", act: () => void (removeLastPoint() || undo()) },
      { keys: "Ctrl+Y", what: "Redo (also Ctrl+Shift+Z)", act: () => void redo() },
    ],
  },
  {
    title: "View",
    list: [
      { keys: "ArrowLeft", what: "Orbit left; previous frame", act: aside(-1) },
      { keys: "ArrowRight", what: "Orbit right; next frame", act: aside(1) },
      { keys: "ArrowUp", what: "Orbit up", act: () => view().stage.circle(0, -AROUND, 1) },
      { keys: "ArrowDown", what: "Orbit down", act: () => view().stage.circle(0, AROUND, 1) },
      { keys: "1", what: "Look from the front", act: () => view().stage.lookFrom(0, 0) },
      { keys: "3", what: "Look from the right", act: () => view().stage.lookFrom(Math.PI / 2, 0) },
      { keys: "7", what: "Look from above", act: () => view().stage.lookFrom(0, Math.PI / 2) },
      { keys: "9", what: "Look from the other side", act: () => view().stage.circle(Math.PI, 0, 1) },
      { keys: "+", what: "Zoom in", act: () => view().stage.circle(0, 0, 1 / NEARER) },
      { keys: "-", what: "Zoom out", act: () => view().stage.circle(0, 0, NEARER) },
      { keys: "Space", what: "Play or pause the clip or the animation", act: togglePlay },
      { keys: "F", what: "Frame the model", act: () => view().stage.frame() },
      { keys: "U", what: "Materials or clay", act: () => s.choose({ materials: !s.settings.peek().materials }) },
      { keys: "W", what: "Wire on or off", act: () => s.choose({ wire: !s.settings.peek().wire }) },
      {
        keys: "K",
        what: "Stretch colours on or off",
        act: () => s.choose({ colouring: s.settings.peek().colouring === "stretch" ? "handles" : "stretch" }),
      },
      { keys: "A", what: "Gizmo along the handle's own axes", act: () => s.choose({ localAxes: !s.settings.peek().localAxes }) },
      { keys: "D", what: "Dark, light or as the system", act: nextTheme, always: true },
      { keys: "?", what: "This sheet", act: () => (s.helpOpen.value = !s.helpOpen.peek()), always: true },
    ],
  },
];

/** Listens on the page. */
export function installKeys(): void {
  const byKey = new Map(SHORTCUTS.flatMap(({ list }) => list).map((shortcut) => [shortcut.keys.toLowerCase(), shortcut]));
  addEventListener("keydown", (event) => {
    if (transformKey(event)) return event.preventDefault();
    const target = event.target as HTMLElement;
    const control = event.ctrlKey || event.metaKey;
    // Numbers and choices have no history of their own: with Ctrl, keys are the page's.
    const typing = target.matches("input:not([type=checkbox]):not([type=range]), select, textarea") && !(control && target.matches("[type=number], select"));
    // Arrows belong to what they move: a list of options, the choice among a few.
    const choosing = event.key.startsWith("Arrow") && target.matches("input, [role=radio]");
    // A choice that is made already does nothing more with them.
    const pressing = target.matches("button:not([aria-checked=true]), summary, a") && (event.key === "Enter" || event.key === " ");
    const escaping = event.key === "Escape";
    if ((typing && !escaping) || pressing || choosing || s.busy.peek() !== undefined || leavingQuestion.peek() !== undefined) return;
    if (event.altKey) return;
    let name = `${control ? "ctrl+" : ""}${event.key.toLowerCase()}`;
    if (name === "ctrl+z" && event.shiftKey) name = "ctrl+y";
    if (name === "backspace") name = "delete";
    if (name === " ") name = "space";
    const shortcut = byKey.get(name);
    if (shortcut === undefined || (shortcut.always !== true && s.doc.peek() === undefined)) return;
    event.preventDefault();
    if (target.matches("input, select")) target.blur();
    shortcut.act();
  });
}
