/** The empty state: how to open something, and what was open before. */

import type { schema } from "pliant-client";
import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { type Kept, canReopen, kept } from "../app/keeping.ts";
import { EXTENSIONS, client, openSample, reopen, resume } from "../app/opening.ts";
import { pickFiles } from "./files.ts";
import { Button, count, things } from "./parts.tsx";

/** Sessions listed at most. */
const MOST = 5;

export function Start(): JSX.Element {
  const [last, setLast] = useState<Kept>();
  const [sessions, setSessions] = useState<readonly schema.Session[]>();
  const [failure, setFailure] = useState<string>();
  useEffect(() => {
    void kept().then(setLast);
    client.sessions().then(
      (found) => {
        setSessions(found.reverse());
        setFailure(undefined);
      },
      (error: unknown) => setFailure(error instanceof Error ? error.message : String(error)),
    );
  }, []);
  const lastIsOpen = sessions?.some(({ id }) => id === last?.session) ?? false;
  const others = sessions?.filter(({ id }) => id !== last?.session) ?? [];
  return (
    <div class="card start">
      <h1>Bend a model</h1>
      <p>
        Drop a file or a folder anywhere on this page: {EXTENSIONS.slice(0, -1).join(", ")} or {EXTENSIONS.at(-1)}. It is sent to this
        server and to nowhere else.
      </p>
      <div class="row">
        <Button kind="main" icon="open" label="Open a model…" keys="Ctrl+O" onClick={pickFiles} />
        <Button label="Open the sample creature" onClick={() => void openSample()} />
      </div>
      {failure !== undefined && (
        <p class="warning" role="alert">
          {failure}
          <small>Start the server with “pliant serve”, then reload this page.</small>
        </p>
      )}
      {last !== undefined && (
        <section>
          <h2>Last time</h2>
          <div class="session">
            <span>
              <strong>{last.name}</strong>
              <small>
                {count(last.rest.length / 3)} vertices, {things(last.handles.length, "handle")}
                {sessions !== undefined && !lastIsOpen && "; the server no longer holds it"}
              </small>
            </span>
            {lastIsOpen ? (
              <Button label="Go on" onClick={() => void resume(last.session)} />
            ) : (
              <Button
                label="Open again with its handles"
                disabled={sessions === undefined || !canReopen(last)}
                onClick={() => void reopen(last)}
              />
            )}
          </div>
        </section>
      )}
      {others.length > 0 && (
        <section>
          <h2>Open on this server</h2>
          {others.slice(0, MOST).map(({ id, label, model, handles }) => (
            <div class="session">
              <span>
                <strong>{label || id.slice(0, 8)}</strong>
                <small>
                  {count(model?.vertices)} vertices, {things(handles.length, "handle")}
                </small>
              </span>
              <Button label="Go on" onClick={() => void resume(id)} />
            </div>
          ))}
          {others.length > MOST && <p class="hint">and {others.length - MOST} more</p>}
        </section>
      )}
    </div>
  );
}
