/** Failures and news, at the foot of the canvas. They leave after a while, unless someone is reading. */

import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import * as s from "../app/signals.ts";
import { Button } from "./parts.tsx";

/** How long a note stays: failures long enough to be read twice. */
const STAYS_MS: Record<s.Note["kind"], number> = { error: 30_000, info: 5_000 };

export function Notes(): JSX.Element {
  return (
    <div class="notes" aria-live="polite">
      {s.notes.value.map((note) => (
        <Notice key={note.id} {...note} />
      ))}
    </div>
  );
}

function Notice({ id, kind, title, detail }: s.Note): JSX.Element {
  const [held, setHeld] = useState(false);
  useEffect(() => {
    if (held) return undefined;
    const timer = setTimeout(() => s.dismiss(id), STAYS_MS[kind]);
    return () => clearTimeout(timer);
  }, [id, kind, held]);
  return (
    <div
      class={`notice ${kind}`}
      role={kind === "error" ? "alert" : "status"}
      onMouseEnter={() => setHeld(true)}
      onMouseLeave={() => setHeld(false)}
      onFocusIn={() => setHeld(true)}
      onFocusOut={() => setHeld(false)}
    >
      <span>
        <strong>{title}</strong>
        {detail && <small>{detail}</small>}
      </span>
      <Button bare icon="close" label="Dismiss" onClick={() => s.dismiss(id)} />
    </div>
  );
}
