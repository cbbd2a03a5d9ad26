/**
 * Where sessions are, when several servers share a store: each is at one of them, and every other one says where, in the headers
 * `x-pliant-owner` and `x-pliant-node`.
 */

/** A server to call: its address, and the name by which a proxy before several of them chooses. */
export interface Place {
  readonly url: string;
  readonly node?: string;
}

/** Sessions whose places are remembered; the one that was learned first is forgotten first. */
const REMEMBERED = 1000;

/** Most redirects that a call follows; after them it waits and starts again. */
export const MOST_HOPS = 4;

/** Where sessions are, from the servers' answers. */
export class Places {
  private readonly known = new Map<string, Place>();

  constructor(private readonly home: string) {}

  /** Where a call goes. */
  of(path: string): Place {
    return this.known.get(sessionOf(path)) ?? { url: this.home };
  }

  /** Where an answer redirects its call; undefined without a redirect, or for one from https to http. */
  told(status: number, header: (name: string) => string | null): Place | undefined {
    const url = status === 503 ? header("x-pliant-owner") : null;
    if (url === null || (this.home.startsWith("https:") && !url.startsWith("https:"))) return undefined;
    const node = header("x-pliant-node");
    return { url: url.replace(/\/+$/, ""), ...(node !== null && { node }) };
  }

  /** Remembers where a call was answered. */
  remember(path: string, place: Place): void {
    const session = sessionOf(path);
    if (session === "") return;
    this.known.delete(session);
    if (place.url === this.home && place.node === undefined) return;
    this.known.set(session, place);
    for (const oldest of this.known.keys()) {
      if (this.known.size <= REMEMBERED) break;
      this.known.delete(oldest);
    }
  }

  /** The place does not answer: the next call starts at `home`. */
  forget(path: string): void {
    this.known.delete(sessionOf(path));
  }
}

/** The session that a path is about; nothing for all others. */
function sessionOf(path: string): string {
  return /^\/v1\/sessions\/([^/?]+)/.exec(path)?.[1] ?? "";
}
