/** Calls whose server may stop in the middle of them without a word: one that stands still, or a machine that is gone. */

/** Silence after which somebody who owes an answer is asked for a sign of life, and how long that sign may take. */
export const SILENCE_MS = 3_000;
export const SIGN_OF_LIFE_MS = 6_000;

type Fetch = typeof globalThis.fetch;

/**
 * Makes a call, and asks `sign` beside it now and then, to which any answer will do. Where none comes the call is given up: it
 * fails as one whose connection was lost. However long a server works on a call, it answers others meanwhile.
 */
export async function whileAlive(fetch: Fetch, call: [string, RequestInit], sign: [string, RequestInit]): Promise<Response> {
  const gone = new AbortController();
  let isOver = false;
  const look = async (): Promise<void> => {
    timer = setTimeout(() => gone.abort(new Error("no sign of life")), SIGN_OF_LIFE_MS);
    try {
      const answer = await fetch(sign[0], { ...sign[1], signal: gone.signal });
      await answer.body?.cancel();
    } catch (error) {
      gone.abort(error);
    }
    clearTimeout(timer);
    if (!isOver) timer = setTimeout(() => void look(), SILENCE_MS);
  };
  let timer = setTimeout(() => void look(), SILENCE_MS);
  try {
    return await fetch(call[0], { ...call[1], signal: gone.signal });
  } finally {
    isOver = true;
    clearTimeout(timer);
  }
}
