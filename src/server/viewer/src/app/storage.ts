/** Small things that outlive a reload. A browser may refuse to keep them; then the page forgets, nothing more. */

type Place = "localStorage" | "sessionStorage";

export function recall(place: Place, key: string): string | undefined {
  try {
    return window[place].getItem(key) ?? undefined;
  } catch {
    return undefined;
  }
}

/** Keeps a text, or drops it without one. */
export function store(place: Place, key: string, text: string | undefined): void {
  try {
    if (text === undefined) window[place].removeItem(key);
    else window[place].setItem(key, text);
  } catch {
    // Private windows and full disks.
  }
}
