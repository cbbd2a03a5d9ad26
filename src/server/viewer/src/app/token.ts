/** The token of the caller: requested when the server requires one, kept until the tab is closed. */

import { signal } from "@preact/signals";
import { recall, store } from "./storage.ts";

/** The key of the session's storage; nothing else holds it. */
const KEPT = "pliant.token";

/** Somebody waits for a token. */
export interface TokenQuestion {
  /** Whether one was refused. */
  readonly refused: boolean;
  /** Answers; without a token the call fails. */
  readonly answer: (token: string | undefined) => void;
}

export const tokenQuestion = signal<TokenQuestion | undefined>(undefined);

/** The token of this tab. */
export function keptToken(): string | undefined {
  return recall("sessionStorage", KEPT);
}

/** Asks the user. */
export function askToken(refused: boolean): Promise<string | undefined> {
  return new Promise((resolve) => {
    const answer = (token: string | undefined): void => {
      tokenQuestion.value = undefined;
      store("sessionStorage", KEPT, token);
      resolve(token);
    };
    tokenQuestion.value = { refused, answer };
  });
}
