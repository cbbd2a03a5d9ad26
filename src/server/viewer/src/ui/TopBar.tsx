/** The bar at the top: what is open, undo and redo, export, theme, help. */

import type { JSX } from "preact";
import type { Format } from "pliant-client";
import { closeModel } from "../app/opening.ts";
import { redo, redoes, undo, undoes } from "../app/past.ts";
import * as s from "../app/signals.ts";
import { exportModel, pickFiles } from "./files.ts";
import { Button } from "./parts.tsx";

const NEXT_THEME: Record<s.Theme, s.Theme> = { auto: "dark", dark: "light", light: "auto" };
const THEME_ICON = { auto: "auto", dark: "moon", light: "sun" } as const;

export function nextTheme(): void {
  s.choose({ theme: NEXT_THEME[s.settings.peek().theme] });
}

/** What a button would do now. */
function told(way: string, what: string | undefined): string {
  return what === undefined ? way : `${way}: ${what}`;
}

export function TopBar(): JSX.Element {
  const open = s.doc.value;
  const { theme } = s.settings.value;
  return (
    <header class="topbar">
      <span class="mark">
        <svg viewBox="0 0 32 32" aria-hidden="true">
          <path d="M7 25c0-9 5-8 9-11s3-7 9-7" />
          <circle cx="7" cy="25" r="3.5" />
          <circle class="tip" cx="25" cy="7" r="4" />
        </svg>
        pliant
      </span>
      {open && (
        <>
          <span class="name" title={open.name}>
            {open.name}
          </span>
          <Button bare icon="close" label="Close the model" onClick={() => void closeModel()} />
        </>
      )}
      <span class="gap" />
      {open && (
        <>
          <Button bare icon="undo" label={told("Undo", undoes.value)} keys="Ctrl+Z" disabled={undoes.value === undefined} onClick={() => void undo()} />
          <Button bare icon="redo" label={told("Redo", redoes.value)} keys="Ctrl+Y" disabled={redoes.value === undefined} onClick={() => void redo()} />
          <span class="rule" />
          <Button icon="open" label="Open…" keys="Ctrl+O" onClick={pickFiles} />
          <ExportButton />
          <span class="rule" />
        </>
      )}
      <Button bare icon={THEME_ICON[theme]} label={`Theme: ${theme}`} keys="D" onClick={nextTheme} />
      <Button bare icon="help" label="Help" keys="?" onClick={() => (s.helpOpen.value = true)} />
    </header>
  );
}

const FORMATS: readonly Format[] = ["glb", "gltf", "obj", "ply", "off", "stl", "3mf"];

/** Saves as GLB; the arrow beside it offers the other formats. */
function ExportButton(): JSX.Element {
  return (
    <span class="split">
      <Button icon="save" label="Export GLB" keys="Ctrl+S" kind="main" onClick={() => void exportModel("glb")} />
      <select
        aria-label="Export as another format"
        value=""
        onChange={(event) => {
          const format = event.currentTarget.value as Format;
          event.currentTarget.value = "";
          void exportModel(format);
        }}
      >
        <option value="" disabled hidden />
        {FORMATS.filter((format) => format !== "gltf").map((format) => (
          <option value={format}>{format.toUpperCase()}</option>
        ))}
      </select>
    </span>
  );
}
