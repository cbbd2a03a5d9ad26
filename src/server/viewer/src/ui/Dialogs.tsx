/** What lies over the canvas while something is under way or lost: busy, reconnecting, gone. */

import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { retryNow } from "../app/dragging.ts";
import { canReopen } from "../app/keeping.ts";
import { documentNow, leave, reopenShown } from "../app/opening.ts";
import * as s from "../app/signals.ts";
import { Button, things } from "./parts.tsx";

/** Work that is done sooner is not worth a sign. */
const PATIENCE_MS = 150;

export function Dialogs(): JSX.Element | null {
  const busy = s.busy.value;
  const { state } = s.link.value;
  if (busy !== undefined) return <Busy {...busy} />;
  if (state === "gone") return <Gone />;
  if (state === "lost") return <Lost />;
  return null;
}

function Busy({ title, detail, fraction, cancel }: s.Busy): JSX.Element | null {
  const [late, setLate] = useState(false);
  useEffect(() => {
    const timer = setTimeout(() => setLate(true), PATIENCE_MS);
    return () => clearTimeout(timer);
  }, []);
  if (!late) return null;
  return (
    <div class="card busy" role="status">
      <h2>{title}</h2>
      <p>{detail ?? "One moment"}</p>
      <progress {...(fraction === undefined || fraction === 0 ? {} : { value: fraction })} aria-label={title} />
      {cancel && <Button label="Cancel" onClick={cancel} />}
    </div>
  );
}

function Lost(): JSX.Element {
  const reason = s.link.value.reason;
  return (
    <div class="banner" role="status">
      <span class="dot lost" />
      <span>
        <strong>Reconnecting.</strong> {reason?.message ?? "The connection was lost"}. The page keeps what you drag and
        sends it when the server is back.
      </span>
      <Button label="Try now" onClick={retryNow} />
    </div>
  );
}

function Gone(): JSX.Element {
  void [s.doc.value, s.handles.value];
  const shown = documentNow();
  const possible = shown !== undefined && canReopen(shown);
  return (
    <div class="card" role="alertdialog" aria-labelledby="gone-title">
      <h2 id="gone-title">The server no longer has this session</h2>
      <p>It was restarted, or the session expired. The screen shows the last shape that the server sent.</p>
      {possible ? (
        <p>
          This page still has <strong>{shown.name}</strong> and its{" "}
          {shown.beforeEdits === undefined
            ? `${things(shown.handles.length, "handle")} with poses, the last one included.`
            : `${things(shown.beforeEdits.length, "handle")} with poses, as they were before the first edit; edits are not repeated.`}
        </p>
      ) : (
        <p>This page does not have the model's file, so open it again from your disk.</p>
      )}
      <div class="row">
        {possible && <Button kind="main" label="Open it again" onClick={() => void reopenShown()} />}
        <Button label="Start page" onClick={leave} />
      </div>
    </div>
  );
}
