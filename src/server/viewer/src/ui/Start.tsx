/** The empty state: how to open something, what is open on the server, and what this browser had open before. */

import type { schema } from "pliant-client";
import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { type Kept, allKept, canReopen, markOf } from "../app/keeping.ts";
import { EXTENSIONS, client, openSample, reopen, resume } from "../app/opening.ts";
import { keptToken, tokenQuestion } from "../app/token.ts";
import { ageOf, timeTo } from "./age.ts";
import { pickFiles } from "./files.ts";
import { Button, things } from "./parts.tsx";
import { count } from "../model/words.ts";

type KeptModel = Kept & { readonly keptAt: number };

/** What there is to go on with. */
interface Lists {
  /** Sessions of whoever asks, the newest first; unknown while the server does not tell. */
  readonly sessions?: readonly schema.Session[];
  readonly failure?: string;
  /** Models that this browser keeps of whoever asks, the newest first. */
  readonly records: readonly KeptModel[];
}

async function look(): Promise<Lists> {
  const asked = await client.sessions().then(
    (sessions) => ({ sessions: sessions.reverse() }),
    (error: unknown) => ({ failure: error instanceof Error ? error.message : String(error) }),
  );
  // Asking may have brought a token.
  return { ...asked, records: await allKept(await markOf(keptToken())) };
}

export function Start(): JSX.Element {
  const [{ sessions, failure, records }, setLists] = useState<Lists>({ records: [] });
  useEffect(() => {
    let shown = true;
    const refresh = (): void => void look().then((lists) => shown && setLists(lists));
    // What other windows and programs opened and closed meanwhile is seen on coming back.
    const attend = (): void => {
      if (document.visibilityState === "visible" && tokenQuestion.peek() === undefined) refresh();
    };
    refresh();
    addEventListener("focus", attend);
    document.addEventListener("visibilitychange", attend);
    return () => {
      shown = false;
      removeEventListener("focus", attend);
      document.removeEventListener("visibilitychange", attend);
    };
  }, []);
  const open = new Set(sessions?.map(({ id }) => id));
  const before = records.filter(({ session }) => !open.has(session));
  return (
    <div class="card start">
      <h1>Bend a model</h1>
      <p>
        Drop a file or a folder anywhere on this page: {EXTENSIONS.slice(0, -1).join(", ")} or {EXTENSIONS.at(-1)}. The page sends it
        to this server only.
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
      {sessions !== undefined && sessions.length > 0 && (
        <section aria-label="Open on this server">
          <h2>Open on this server</h2>
          {sessions.map((session) => (
            <OpenSession key={session.id} session={session} known={records.find(({ session: id }) => id === session.id)} />
          ))}
        </section>
      )}
      {before.length > 0 && (
        <section aria-label="Last time">
          <h2>Last time</h2>
          {before.map((record) => (
            <Entry
              key={record.session}
              name={record.name}
              at={record.keptAt}
              happened="used"
              vertices={record.rest.length / 3}
              handles={record.handles.length}
              more={sessions !== undefined ? "the server no longer has it" : undefined}
            >
              <Button
                label="Open again with its handles"
                disabled={sessions === undefined || !canReopen(record)}
                onClick={() => void reopen(record)}
              />
            </Entry>
          ))}
        </section>
      )}
    </div>
  );
}

function OpenSession({ session, known }: { session: schema.Session; known: KeptModel | undefined }): JSX.Element {
  const { id, label, model, handles, createdAt, expiresAt, revision } = session;
  // The browser knows when it used a session itself; of others' use the server tells by when the session ends without more of it.
  const used = ageOf(known?.keptAt ?? Number.NaN);
  const ends = timeTo(Date.parse(expiresAt));
  const life = used !== undefined ? `, used here ${used}` : ends !== undefined ? `, expires ${ends} if unused` : "";
  const name = label || known?.name || `${(model?.format || "model").toUpperCase()} ${id.slice(0, 8)}`;
  return (
    <Entry name={name} at={Date.parse(createdAt)} happened="opened" vertices={model?.vertices ?? 0} handles={handles.length} more={`revision ${revision}${life}`}>
      <Button label="Resume" onClick={() => void resume(id)} />
    </Entry>
  );
}

interface EntryProps {
  name: string;
  at: number;
  happened: string;
  vertices: number;
  handles: number;
  more?: string | undefined;
  children: JSX.Element;
}

/** One line: a model's name, how old it is, how large, and what can be done with it. */
function Entry({ name, at, happened, vertices, handles, more, children }: EntryProps): JSX.Element {
  const age = ageOf(at);
  return (
    <div class="session">
      <span>
        <strong title={name}>{name}</strong>
        <small title={age && new Date(at).toLocaleString()}>
          {age && `${happened} ${age}, `}
          {count(vertices)} vertices, {things(handles, "handle")}
          {more && `; ${more}`}
        </small>
      </span>
      {children}
    </div>
  );
}
