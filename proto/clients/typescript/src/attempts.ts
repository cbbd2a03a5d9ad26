/** When something that failed is worth another try: soon at first, then after longer and longer pauses, until the patience ends. */

import { PliantError } from "./errors.js";

/** Pauses between tries, in milliseconds; the last one repeats. */
const PAUSES = [100, 250, 500, 1000];

/** Tries of one thing. */
export class Attempts {
  private count = 0;
  private since: number | undefined;

  /** `patience`: seconds from the first failure on. */
  constructor(private readonly patience: number) {}

  /** Milliseconds to wait before the next try, no fewer than the server asked for; undefined when the failure stands. */
  again(error: PliantError): number | undefined {
    this.since ??= Date.now();
    const left = this.patience * 1000 - (Date.now() - this.since);
    const wanted = (error.retryAfter ?? 0) * 1000;
    if (left <= 0 || wanted > left) return undefined;
    const usual = PAUSES[Math.min(this.count, PAUSES.length - 1)] as number;
    this.count += 1;
    // Not all clients of a server that was started again come at the same moment.
    return Math.max(wanted, Math.min(usual * (0.5 + Math.random() / 2), left));
  }

  /** It worked: the next failure is the first again. */
  worked(): void {
    this.count = 0;
    this.since = undefined;
  }

  /** The next try comes soon, however many there were. */
  hurry(): void {
    this.count = 0;
  }

  /** The failure that stands, with how long it was tried. */
  lastWord({ code, message, status, retryAfter }: PliantError): PliantError {
    return new PliantError(code, this.patience > 0 ? `${message} (tried again for ${this.patience} s)` : message, status, retryAfter);
  }
}

/** Waits, unless it is given up meanwhile. */
export function pause(milliseconds: number, signal?: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    const stopped = (): void => {
      clearTimeout(timer);
      reject(signal?.reason);
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", stopped);
      resolve();
    }, milliseconds);
    if (signal?.aborted === true) stopped();
    else signal?.addEventListener("abort", stopped, { once: true });
  });
}

/** A new idempotency key. Also on pages that are not secure, where `randomUUID` is missing. */
export function newKey(): string {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");
}
