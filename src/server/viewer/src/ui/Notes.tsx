/** Failures and news, at the foot of the canvas. */

import type { JSX } from "preact";
import * as s from "../app/signals.ts";
import { Button } from "./parts.tsx";

export function Notes(): JSX.Element {
  return (
    <div class="notes" aria-live="polite">
      {s.notes.value.map(({ id, kind, title, detail }) => (
        <div key={id} class={`notice ${kind}`} role={kind === "error" ? "alert" : "status"}>
          <span>
            <strong>{title}</strong>
            {detail && <small>{detail}</small>}
          </span>
          <Button bare icon="close" label="Dismiss" onClick={() => s.dismiss(id)} />
        </div>
      ))}
    </div>
  );
}
