/** Small pieces that the panels are made of. */

import type { ComponentChildren, JSX } from "preact";
import { useState } from "preact/hooks";
import { recall, store } from "../app/storage.ts";
import { count } from "../model/words.ts";
import { Icon, type IconName } from "./icons.tsx";

interface ButtonProps {
  icon?: IconName;
  label: string;
  /** What it does, where the label alone does not say. */
  hint?: string;
  /** The key that does the same. */
  keys?: string;
  /** Shows the icon alone; the label becomes its name. */
  bare?: boolean;
  kind?: "plain" | "main" | "danger";
  pressed?: boolean;
  disabled?: boolean;
  onClick: () => void;
}

export function Button({ icon, label, hint, keys, bare, kind = "plain", pressed, disabled, onClick }: ButtonProps): JSX.Element {
  const title = hint ?? (keys === undefined ? label : `${label} (${keys})`);
  return (
    <button
      type="button"
      class={`button ${kind}${bare ? " bare" : ""}`}
      title={title}
      aria-label={bare ? title : undefined}
      aria-pressed={pressed}
      disabled={disabled}
      onClick={onClick}
    >
      {icon && <Icon name={icon} />}
      {!bare && <span>{label}</span>}
    </button>
  );
}

/** A part of the side panel that folds away; remembers whether it is open. */
export function Section({ title, note, open = true, children }: { title: string; note?: string; open?: boolean; children: ComponentChildren }): JSX.Element {
  const key = `pliant.section.${title}`;
  const [isOpen] = useState(() => (recall("localStorage", key) ?? String(open)) === "true");
  return (
    <details
      class="section"
      open={isOpen}
      onToggle={(event) => store("localStorage", key, String((event.currentTarget as HTMLDetailsElement).open))}
    >
      <summary>
        <span>{title}</span>
        {note && <span class="note">{note}</span>}
      </summary>
      <div class="body">{children}</div>
    </details>
  );
}

/** A label with its control. */
export function Field({ label, hint, children }: { label: string; hint?: string; children: ComponentChildren }): JSX.Element {
  return (
    <label class="field" title={hint}>
      <span>{label}</span>
      {children}
    </label>
  );
}

interface NumberProps {
  label: string;
  value: number;
  step?: number;
  min?: number;
  max?: number;
  /** Digits shown. */
  digits?: number;
  disabled?: boolean;
  onValue: (value: number) => void;
}

/** A number that is taken over when it is finished: on Enter, on leaving, by the arrows. */
export function NumberInput({ label, value, step = 0.1, min, max, digits = 3, disabled, onValue }: NumberProps): JSX.Element {
  const shown = String(Number(value.toFixed(digits)));
  const take = (input: HTMLInputElement): void => {
    const next = Number(input.value);
    const allowed = Number.isFinite(next) && (min === undefined || next >= min) && (max === undefined || next <= max);
    if (!allowed || input.value.trim() === "") input.value = shown;
    else if (input.value !== shown) onValue(next);
  };
  return (
    <input
      type="number"
      aria-label={label}
      value={shown}
      step={step}
      min={min}
      max={max}
      disabled={disabled}
      onChange={(event) => take(event.currentTarget)}
      onKeyDown={(event) => {
        // Undo takes back what the page did; what was typed and not taken is dropped.
        if ((event.ctrlKey || event.metaKey) && ["z", "y"].includes(event.key.toLowerCase())) event.currentTarget.value = shown;
        // What was typed is taken, and the next key is the page's.
        if (event.key === "Enter") event.currentTarget.blur();
      }}
    />
  );
}

/** One of a few. */
export function Choice<T extends string>({ label, value, options, disabled, onValue }: { label: string; value: T; options: readonly (readonly [T, string])[]; disabled?: boolean; onValue: (value: T) => void }): JSX.Element {
  return (
    <div class="choice" role="radiogroup" aria-label={label}>
      {options.map(([option, text]) => (
        <button
          type="button"
          role="radio"
          aria-checked={option === value}
          disabled={disabled}
          onClick={() => option !== value && onValue(option)}
        >
          {text}
        </button>
      ))}
    </div>
  );
}

export function Select<T extends string>({ label, value, options, onValue }: { label: string; value: T; options: readonly (readonly [T, string])[]; onValue: (value: T) => void }): JSX.Element {
  return (
    <select aria-label={label} value={value} onChange={(event) => onValue(event.currentTarget.value as T)}>
      {options.map(([option, text]) => (
        <option value={option}>{text}</option>
      ))}
    </select>
  );
}

export function Check({ label, checked, disabled, onValue }: { label: string; checked: boolean; disabled?: boolean; onValue: (value: boolean) => void }): JSX.Element {
  return (
    <label class="check">
      <input type="checkbox" checked={checked} disabled={disabled} onChange={(event) => onValue(event.currentTarget.checked)} />
      <span>{label}</span>
    </label>
  );
}

/** Facts in two columns. */
export function Facts({ rows }: { rows: readonly (readonly [string, string, string?])[] }): JSX.Element {
  return (
    <dl class="facts">
      {rows.map(([name, value, hint]) => (
        <div title={hint}>
          <dt>{name}</dt>
          <dd>{value}</dd>
        </div>
      ))}
    </dl>
  );
}

/** A number of things, such as "1 handle". */
export function things(n: number, one: string): string {
  return `${count(n)} ${one}${n === 1 ? "" : "s"}`;
}

/** A time in a clip. */
export function seconds(n: number): string {
  return `${n.toFixed(2)} s`;
}

export function bytes(n: number | bigint | undefined): string {
  const size = Number(n ?? 0);
  if (size < 1024) return `${size} B`;
  const steps = ["KiB", "MiB", "GiB"];
  const k = Math.min(steps.length, Math.floor(Math.log2(size) / 10));
  return `${(size / 1024 ** k).toPrecision(3)} ${steps[k - 1]}`;
}
