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
        <h1 id="token-title">Token needed</h1>
        <p>
          {question?.refused === true ? "The server rejects that token." : "This server needs an access token."} Ask its operator for one. This
          tab keeps the token until you close it.
        </p>
        <div class="row">
          <input ref={field} type="password" aria-label="Token" autocomplete="off" autofocus />
          <Button kind="main" label="Continue" onClick={answer} />
          <Button label="Cancel" onClick={() => question?.answer(undefined)} />
        </div>
      </form>
    </dialog>
  );
}
