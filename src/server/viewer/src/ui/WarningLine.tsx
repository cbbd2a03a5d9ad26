/** Something to know about the model, in a line; where it is can be shown, what else is known unfolds. */

import type { schema } from "pliant-client";
import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { showPlace } from "../app/pointing.ts";
import { headlineOf, otherPlaces, placesOf } from "../model/warnings.ts";

type Told = Pick<schema.Warning, "code" | "message" | "where" | "vertices" | "position">;

export function WarningLine({ warning }: { warning: Told }): JSX.Element {
  const [open, setOpen] = useState(false);
  const [next, setNext] = useState(0);
  const places = placesOf(warning);
  const others = otherPlaces(warning);
  const show = (): void => {
    const place = places[next % places.length];
    if (place === undefined) return;
    showPlace(place);
    setNext((next % places.length) + 1);
  };
  const headline = headlineOf(warning.message);
  return (
    <div class={`warning${open ? "" : " line"}`}>
      <button type="button" class="text" aria-expanded={open} title={[warning.message, others].filter(Boolean).join("\n")} onClick={() => setOpen(!open)}>
        {open ? warning.message : headline}
        {open && others !== undefined && <small>{others}</small>}
      </button>
      {places.length > 0 && (
        <button type="button" class="show" title={`Place ${(next % places.length) + 1} of ${places.length}: ${headline}`} onClick={show}>
          {next === 0 ? "Show me" : `${next} of ${places.length}`}
        </button>
      )}
    </div>
  );
}

/** A line of the page's own. */
export function FaultLine({ text }: { text: string }): JSX.Element {
  return <WarningLine warning={{ code: "", message: text, where: "", vertices: [], position: [] }} />;
}
