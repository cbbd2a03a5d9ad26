/** What lies over the canvas while something is under way or lost: busy, reconnecting, gone. */

import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { retryNow } from "../app/dragging.ts";
import { type Kept, canReopen, kept } from "../app/keeping.ts";
import { leave, reopen } from "../app/opening.ts";
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
        <strong>Reconnecting.</strong> {reason?.message ?? "The connection was lost"}. The session stays; what you drag is sent
        when the server is back.
      </span>
      <Button label="Try now" onClick={retryNow} />
    </div>
  );
}

function Gone(): JSX.Element {
  const [last, setLast] = useState<Kept>();
  const open = s.doc.value;
  useEffect(() => {
    void kept().then((found) => found?.session === open?.session.id && setLast(found));
  }, []);
  const possible = last !== undefined && canReopen(last);
  return (
    <div class="card" role="alertdialog" aria-labelledby="gone-title">
      <h2 id="gone-title">The server no longer has this session</h2>
      <p>It was restarted, or the session expired. What is on the screen is the last shape that was sent.</p>
      {possible ? (
        <p>
          This page still has <strong>{last.name}</strong> and its {things(last.handles.length, "handle")} with poses
          {last.beforeEdits === undefined ? "." : ", as they were before the first edit; edits are not repeated."}
        </p>
      ) : (
        <p>The file was not opened from this page, so it must be opened again from where it is.</p>
      )}
      <div class="row">
        {possible && <Button kind="main" label="Open it again" onClick={() => void reopen(last)} />}
        <Button label="Start page" onClick={leave} />
      </div>
    </div>
  );
}
