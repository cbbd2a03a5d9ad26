/** What a call can fail with: the server's own words, or the reason why it could not be asked. */

/** gRPC status names by number, as stream errors carry them. */
const STATUS: readonly string[] = [
  "OK",
  "CANCELLED",
  "UNKNOWN",
  "INVALID_ARGUMENT",
  "DEADLINE_EXCEEDED",
  "NOT_FOUND",
  "ALREADY_EXISTS",
  "PERMISSION_DENIED",
  "RESOURCE_EXHAUSTED",
  "FAILED_PRECONDITION",
  "ABORTED",
  "OUT_OF_RANGE",
  "UNIMPLEMENTED",
  "INTERNAL",
  "UNAVAILABLE",
  "DATA_LOSS",
  "UNAUTHENTICATED",
];

/** The name of a gRPC status number. */
export function statusName(code: number): string {
  return STATUS[code] ?? "UNKNOWN";
}

/** A call or a pose failed. `message` is the server's text where it gave one. */
export class PliantError extends Error {
  override readonly name = "PliantError";
  constructor(
    /** The status name, such as `INVALID_ARGUMENT`; `UNREACHABLE` when no answer came at all. */
    readonly code: string,
    message: string,
    /** The HTTP status; 0 without one. */
    readonly status = 0,
    /** Seconds to wait before asking again, when the server says so. */
    readonly retryAfter?: number,
  ) {
    super(message);
  }

  /** Whether the session asked for is not there (any more). */
  get isGone(): boolean {
    return this.code === "NOT_FOUND";
  }

  /** Whether this version of the server does not do what was asked. */
  get isUnimplemented(): boolean {
    return this.code === "UNIMPLEMENTED";
  }

  /** Whether the server is away or stopping, or still works on the same call; the call may be repeated. */
  get isAway(): boolean {
    const runs = this.code === "ABORTED" && this.retryAfter !== undefined;
    return this.code === "UNREACHABLE" || this.code === "UNAVAILABLE" || runs;
  }

  /** Whether the same call may succeed later: the server is away, busy or stopping. */
  get isTransient(): boolean {
    return this.code === "UNREACHABLE" || this.code === "UNAVAILABLE" || this.code === "RESOURCE_EXHAUSTED";
  }
}

/** Reads a problem document (RFC 9457), or makes do with the status line. */
export function problemOf(status: number, statusText: string, body: string, retryAfter: string | null): PliantError {
  const seconds = retryAfter === null ? Number.NaN : Number(retryAfter);
  const wait = Number.isFinite(seconds) ? seconds : undefined;
  try {
    const document: unknown = JSON.parse(body);
    if (typeof document === "object" && document !== null) {
      const { code, detail } = document as { code?: unknown; detail?: unknown };
      if (typeof code === "string" && typeof detail === "string") {
        return new PliantError(code, detail, status, wait);
      }
    }
  } catch {
    // Not JSON: a proxy's page, or an answer that was cut.
  }
  const text = `${status} ${statusText}`.trim();
  const code = status === 502 || status === 503 || status === 504 ? "UNAVAILABLE" : "UNKNOWN";
  return new PliantError(code, `the server answered ${text}`, status, wait);
}
