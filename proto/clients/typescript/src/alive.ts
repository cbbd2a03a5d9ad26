/** Calls whose server may stop in the middle of them without a word: one that stands still, or a machine that is gone. */

import { PliantError } from "./errors.js";

/** Silence after which somebody who owes an answer is asked for a sign of life, and how long that sign may take. */
export const SILENCE_MS = 3_000;
export const SIGN_OF_LIFE_MS = 6_000;

/** How long a call may take, and how long a server may be silent meanwhile; 0 is without end. */
export interface Waits {
  /** For the whole call. */
  readonly timeoutMs: number;
  /** For a sign of life. */
  readonly signMs: number;
}

/** A call: given up, and its answer's body too, when the signal says so. */
export interface Watched<T> {
  readonly call: (signal: AbortSignal) => Promise<T>;
  /** Asks for a sign of life beside the call, to which any answer will do. */
  readonly sign: (signal: AbortSignal) => Promise<unknown>;
  /** Whether a sign can be asked for now. */
  readonly mayAsk: () => boolean;
  /** The caller's own. */
  readonly signal?: AbortSignal | undefined;
}

/**
 * Makes a call, and asks for a sign of life beside it now and then. Where none comes the call is given up: it fails as one whose
 * connection was lost. However long a server works on a call, it answers others meanwhile.
 */
export async function whileAlive<T>({ call, sign, mayAsk, signal }: Watched<T>, { timeoutMs, signMs }: Waits): Promise<T> {
  const gone = new AbortController();
  let isOver = false;
  let silence: ReturnType<typeof setTimeout> | undefined;
  const listen = (): void => {
    if (!isOver && signMs > 0) silence = setTimeout(() => void look(), SILENCE_MS);
  };
  const look = async (): Promise<void> => {
    if (!mayAsk()) return listen();
    const silent = new PliantError("UNREACHABLE", `the server did not answer for ${signMs / 1000} s`);
    silence = setTimeout(() => gone.abort(silent), signMs);
    try {
      await sign(gone.signal);
    } catch {
      gone.abort(silent);
    }
    clearTimeout(silence);
    listen();
  };
  const late = new PliantError("DEADLINE_EXCEEDED", `no answer within ${timeoutMs / 1000} s`);
  const timeout = timeoutMs > 0 ? setTimeout(() => gone.abort(late), timeoutMs) : undefined;
  const stopped = (): void => gone.abort(signal?.reason);
  if (signal?.aborted === true) stopped();
  else signal?.addEventListener("abort", stopped, { once: true });
  listen();
  try {
    return await orGone(call(gone.signal), gone.signal);
  } finally {
    isOver = true;
    clearTimeout(silence);
    clearTimeout(timeout);
    signal?.removeEventListener("abort", stopped);
    // A sign that is still asked for has nobody any more who wants it.
    gone.abort();
  }
}

/** What a call answers, or why it was given up, also where the call does not heed its signal. */
function orGone<T>(call: Promise<T>, gone: AbortSignal): Promise<T> {
  return new Promise((resolve, reject) => {
    if (gone.aborted) reject(gone.reason);
    gone.addEventListener("abort", () => reject(gone.reason), { once: true });
    call.then(resolve, (error) => reject(gone.aborted ? gone.reason : error));
  });
}
