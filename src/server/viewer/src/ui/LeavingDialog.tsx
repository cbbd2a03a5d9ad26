/** Asks what becomes of a session with work in it before the page leaves it. */

import type { JSX } from "preact";
import { useEffect, useRef } from "preact/hooks";
import { leavingQuestion } from "../app/leaving.ts";
import { Button } from "./parts.tsx";

export function LeavingDialog(): JSX.Element {
  const sheet = useRef<HTMLDialogElement>(null);
  const question = leavingQuestion.value;
  useEffect(() => {
    if (question !== undefined) sheet.current?.showModal();
    else sheet.current?.close();
  }, [question]);
  return (
    <dialog class="help token" ref={sheet} role="alertdialog" aria-labelledby="leaving-title" onCancel={() => question?.answer("stay")}>
      <h1 id="leaving-title">Keep your changes to {question?.name}?</h1>
      <p>
        “Keep” leaves the session on this server: the start page lists it under “Open on this server” until it expires unused. “Discard”
        deletes the session and its history.
      </p>
      <div class="row">
        <Button kind="main" label="Keep" onClick={() => question?.answer("keep")} />
        <Button kind="danger" label="Discard" onClick={() => question?.answer("discard")} />
        <span class="gap" />
        <Button label="Cancel" onClick={() => question?.answer("stay")} />
      </div>
    </dialog>
  );
}
