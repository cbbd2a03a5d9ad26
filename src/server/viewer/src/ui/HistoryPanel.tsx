/** The commits, newest first; a click goes there. */

import type { JSX } from "preact";
import { goTo, nameOf } from "../app/past.ts";
import * as s from "../app/signals.ts";
import { Section } from "./parts.tsx";

export function HistoryPanel(): JSX.Element {
  const list = s.commits.value;
  const current = s.currentRevision.value;
  const at = list.findIndex(({ revision }) => revision === current);
  return (
    <Section title="History" note={list.length > 0 ? `${at + 1} of ${list.length}` : ""}>
      <ol class="history">
        {list
          .map((commit, k) => ({ commit, k }))
          .reverse()
          .map(({ commit: { revision, kind, digest }, k }) => (
            <li key={String(revision)} class={k === at ? "current" : k > at ? "undone" : ""}>
              <button type="button" aria-current={k === at ? "step" : undefined} title={digest} onClick={() => void goTo(revision)}>
                <span>{nameOf({ revision, kind })}</span>
                <span class="count">{String(revision)}</span>
              </button>
            </li>
          ))}
      </ol>
    </Section>
  );
}
