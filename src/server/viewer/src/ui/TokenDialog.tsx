/** Asks for a token when the server wants to know who asks. */

import type { JSX } from "preact";
import { useEffect, useRef } from "preact/hooks";
import { tokenQuestion } from "../app/token.ts";
import { Button } from "./parts.tsx";

export function TokenDialog(): JSX.Element {
  const sheet = useRef<HTMLDialogElement>(null);
  const field = useRef<HTMLInputElement>(null);
  const question = tokenQuestion.value;
  useEffect(() => {
    if (question !== undefined) sheet.current?.showModal();
    else sheet.current?.close();
  }, [question]);
  const answer = (): void => {
    const token = field.current?.value.trim();
    if (field.current !== null) field.current.value = "";
    question?.answer(token === "" ? undefined : token);
  };
  return (
    <dialog class="help token" ref={sheet} aria-labelledby="token-title" onCancel={() => question?.answer(undefined)}>
      <form
        onSubmit={(event) => {
          event.preventDefault();
          answer();
        }}
      >
        <h1 id="token-title">Who asks?</h1>
        <p>
          {question?.refused === true ? "This server does not know that token, or no longer." : "This server wants to know."}{" "}
          Whoever runs it has tokens. It is kept until this tab is closed.
        </p>
        <div class="row">
          <input ref={field} type="password" aria-label="Token" autocomplete="off" autofocus />
          <Button kind="main" label="Go on" onClick={answer} />
          <Button label="Cancel" onClick={() => question?.answer(undefined)} />
        </div>
      </form>
    </dialog>
  );
}
