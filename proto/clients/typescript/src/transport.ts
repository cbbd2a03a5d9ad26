/**
 * HTTP calls: JSON of the schema's messages in and out, failures as `PliantError`. A server that answered before and cannot be reached
 * now, or is stopping, is asked again for a while; calls that change something carry an idempotency key, so that they happen once.
 * Where several servers share a store, a call about a session goes to the one that has it.
 */

import type { DescMessage, MessageInitShape, MessageShape } from "@bufbuild/protobuf";
import { create, fromJson, toJson } from "@bufbuild/protobuf";
import { SIGN_OF_LIFE_MS, whileAlive } from "./alive.js";
import { Attempts, newKey, pause } from "./attempts.js";
import { PliantError, problemOf } from "./errors.js";
import { type Named, numbered } from "./names.js";
import { MOST_HOPS, type Place, Places } from "./places.js";

/** What a page may set once for all calls. */
export interface TransportOptions {
  /** Where the server is, such as `https://mesh.example.org`. Default: where the page came from, else 127.0.0.1:7411. */
  url?: string;
  /** The token of every call and WebSocket. Default: the environment variable `PLIANT_TOKEN`, where there is one. */
  token?: string;
  /**
   * Called for a token when the server requires one; `refused`: it rejected the last one. The call is repeated with the
   * token; without one it fails.
   */
  askToken?: (refused: boolean) => Promise<string | undefined>;
  /** Seconds for which a server that went away is asked again. Default: 15; 0 gives up at once. */
  patience?: number;
  /** Seconds that one try of a call may take, with its upload and its answer. Default: 600; 0 is without end. */
  timeout?: number;
  /**
   * Seconds that a server which owes an answer may take to give a sign of life, when it is asked for one after 3 s. Default: 6; 0
   * asks for none, so that a server which stands still is waited for until the `timeout`.
   */
  signOfLife?: number;
  /** Headers of every call. A browser's WebSocket cannot send them. */
  headers?: Record<string, string>;
  /** In place of the global `fetch`. */
  fetch?: typeof globalThis.fetch;
  /** In place of the global `WebSocket`. */
  WebSocket?: typeof globalThis.WebSocket;
}

/** How a call is made. */
export interface CallOptions {
  signal?: AbortSignal;
  /** Makes a repeat of the call harmless: the server gives the first answer again. Default: a new one for each call. */
  idempotencyKey?: string;
  /** In place of the client's `patience`, in seconds. */
  patience?: number;
  /** In place of the client's `timeout`, in seconds. */
  timeout?: number;
}

/** The server that must give a sign of life during a call. */
interface Asked {
  url: string;
  headers: Record<string, string>;
}

/** What a call sends, and where it went. */
type Sent = CallOptions & { body?: BodyInit; json?: unknown; asked?: Asked };

/** Calls under way, as many as a page may have to one server by HTTP/1.1, less the one that asks for a sign of life. */
const CALLS_OF_PAGE = 5;

/** The part of an upload that has gone out, 0 to 1. */
export type Progress = (fraction: number) => void;

/** Talks to one server. */
export class Transport {
  readonly url: string;
  /** Private at run time too: logs of a client must not show credentials. */
  readonly #headers: Record<string, string>;
  #token: string | undefined;
  private readonly patience: number;
  private readonly timeout: number;
  private readonly signOfLife: number;
  private underWay = 0;
  /** Whether the server has answered anything: who has never been there is not waited for. */
  private reached = false;
  private readonly askToken: ((refused: boolean) => Promise<string | undefined>) | undefined;
  private asking: Promise<string | undefined> | undefined;
  private readonly places: Places;
  private readonly fetch: typeof globalThis.fetch;
  private readonly Socket: typeof globalThis.WebSocket | undefined;

  constructor(options: TransportOptions = {}) {
    const page = typeof location === "object" && location.protocol.startsWith("http") ? location.origin : undefined;
    this.url = addressOf(options.url ?? page ?? "http://127.0.0.1:7411");
    this.places = new Places(this.url);
    this.#headers = options.headers ?? {};
    this.patience = options.patience ?? 15;
    this.timeout = secondsOf("timeout", options.timeout ?? 600);
    this.signOfLife = secondsOf("signOfLife", options.signOfLife ?? SIGN_OF_LIFE_MS / 1000);
    this.#token = options.token ?? environment("PLIANT_TOKEN");
    this.askToken = options.askToken;
    this.fetch = options.fetch ?? globalThis.fetch.bind(globalThis);
    this.Socket = options.WebSocket ?? globalThis.WebSocket ?? socketOfNode();
  }

  toString(): string {
    return `Transport to ${this.url}`;
  }

  /** What node's console shows. */
  [Symbol.for("nodejs.util.inspect.custom")](): string {
    return this.toString();
  }

  /** A call whose answer is a message. */
  async message<D extends DescMessage>(answer: D, method: string, path: string, call: Sent = {}): Promise<MessageShape<D>> {
    return parse(answer, await this.read(method, path, "application/json", call, (response) => response.text()));
  }

  /** Asks for a message once. */
  async probe<D extends DescMessage>(answer: D, path: string): Promise<MessageShape<D>> {
    const read = async (sent: Sent): Promise<string> => textOf(await this.call("GET", path, "application/json", sent));
    return parse(answer, await this.watched(path, {}, read));
  }

  /** A call whose answer is read by `read`. */
  async read<T>(method: string, path: string, accept: string, call: Sent, read: (response: Response) => Promise<T>): Promise<T> {
    const keyed = withKey(call);
    return this.repeat(call, () =>
      this.watched(path, keyed, async (sent) => {
        const response = await this.call(method, path, accept, sent);
        return read(response).catch((error: unknown) => Promise.reject(unreachable(this.url, error)));
      }),
    );
  }

  /** A call whose answer the caller reads as it comes, in its own time. */
  bytes(method: string, path: string, accept: string, call: Sent = {}): Promise<Response> {
    const keyed = withKey(call);
    return this.repeat(call, () => this.call(method, path, accept, keyed));
  }

  /**
   * Makes one try of a call, and gives it up where it takes too long or its server stands still. A page has few connections to a
   * server: while calls use all of them no sign of life is asked for, since it would wait for them.
   */
  private async watched<S extends Sent, T>(path: string, call: S, attempt: (sent: S) => Promise<T>): Promise<T> {
    const asked: Asked = { url: this.places.of(path).url, headers: {} };
    const isPage = typeof document === "object";
    this.underWay += 1;
    try {
      const watched = {
        call: (signal: AbortSignal) => attempt({ ...call, signal, asked }),
        sign: async (signal: AbortSignal) => {
          const answer = await this.fetch(`${asked.url}/v1/limits`, { headers: asked.headers, signal });
          await answer.body?.cancel();
        },
        mayAsk: () => !isPage || this.underWay <= CALLS_OF_PAGE,
        signal: call.signal,
      };
      const timeout = call.timeout === undefined ? this.timeout : secondsOf("timeout", call.timeout);
      return await whileAlive(watched, { timeoutMs: timeout * 1000, signMs: this.signOfLife * 1000 });
    } catch (error) {
      if (error instanceof PliantError && error.code === "UNREACHABLE") this.places.forget(path);
      throw error;
    } finally {
      this.underWay -= 1;
    }
  }

  /** Deletes something. That it is gone is a success where an earlier try may have done it. */
  async remove(path: string, call: CallOptions = {}): Promise<void> {
    await this.repeat(call, async (again) => {
      try {
        await this.watched(path, call, (sent) => this.call("DELETE", path, "application/json", sent));
      } catch (error) {
        if (!(again && error instanceof PliantError && error.isGone)) throw error;
      }
    });
  }

  /** An upload that reports its progress, where the platform can. */
  async upload<D extends DescMessage>(
    answer: D,
    path: string,
    body: Blob | FormData,
    type: string | undefined,
    call: CallOptions & { onProgress?: Progress },
  ): Promise<MessageShape<D>> {
    const { onProgress, ...keyed } = withKey(call);
    const attempt = async (sent: Sent): Promise<string> => {
      if (onProgress !== undefined && typeof XMLHttpRequest !== "undefined") {
        return this.uploadWatched(path, body, type, sent, onProgress);
      }
      const headers = type === undefined ? {} : { "content-type": type };
      return textOf(await this.call("POST", path, "application/json", { ...sent, body }, headers));
    };
    const text = await this.repeat(call, () => this.watched(path, keyed, attempt));
    return parse(answer, text);
  }

  /** Tries again while the server that was there is away. */
  private async repeat<T>({ signal, patience }: CallOptions, attempt: (again: boolean) => Promise<T>): Promise<T> {
    const attempts = new Attempts(patience ?? this.patience);
    for (let again = false; ; again = true) {
      try {
        return await attempt(again);
      } catch (error) {
        if (!(error instanceof PliantError) || !this.reached || !error.isAway) throw error;
        const wait = attempts.again(error);
        if (wait === undefined) throw attempts.lastWord(error);
        await pause(wait, signal);
      }
    }
  }

  /** Opens a WebSocket on `path`. */
  socket(path: string): WebSocket {
    if (this.Socket === undefined) {
      throw new PliantError("UNIMPLEMENTED", "there is no WebSocket here; node 22 has one, node 20 takes that of `npm install ws`, or give one: `new Client({ WebSocket })`");
    }
    // A page cannot give its WebSocket headers; the token goes as a sub-protocol, which the server does not repeat.
    const protocols = this.#token === undefined ? ["pliant.v1"] : ["pliant.v1", `pliant.bearer.${this.#token}`];
    const { url, node } = this.places.of(path);
    // A page cannot give it headers either.
    const named = node === undefined ? "" : `${path.includes("?") ? "&" : "?"}pliant-node=${encodeURIComponent(node)}`;
    const socket = new this.Socket(url.replace(/^http/, "ws") + path + named, protocols);
    socket.binaryType = "arraybuffer";
    return socket;
  }

  private async call(
    method: string,
    path: string,
    accept: string,
    { body, json, signal, idempotencyKey, asked }: Sent,
    more: Record<string, string> = {},
  ): Promise<Response> {
    const headers: Record<string, string> = { ...this.#headers, accept, ...more };
    const init: RequestInit = { method, headers };
    if (json !== undefined) {
      headers["content-type"] = "application/json";
      init.body = JSON.stringify(json);
    } else if (body !== undefined) {
      init.body = body;
    }
    if (idempotencyKey !== undefined) {
      headers["idempotency-key"] = idempotencyKey;
    }
    if (signal !== undefined) {
      init.signal = signal;
    }
    let response: Response;
    let place = this.places.of(path);
    for (let hops = 0; ; ) {
      const shown = this.show(headers);
      point(headers, place, hops);
      if (asked !== undefined) Object.assign(asked, { url: place.url, headers: signHeaders(headers) });
      try {
        response = await this.fetch(place.url + path, init);
      } catch (error) {
        this.places.forget(path);
        throw unreachable(place.url, error);
      }
      this.reached = true;
      const there = this.places.told(response.status, (name) => response.headers.get(name));
      if (there !== undefined && hops < MOST_HOPS) {
        hops += 1;
        place = there;
        await response.body?.cancel();
      } else if (response.status !== 401 || !(await this.hasOther(shown))) break;
    }
    if (response.status === 503) this.places.forget(path);
    else this.places.remember(path, place);
    if (!response.ok) {
      const { status, statusText } = response;
      throw problemOf(status, statusText, await textOf(response), response.headers.get("retry-after"));
    }
    return response;
  }

  /** Adds the token to the headers of a call; answers which. */
  private show(headers: Record<string, string>): string | undefined {
    if (this.#token !== undefined) headers["authorization"] = `Bearer ${this.#token}`;
    return this.#token;
  }

  /** Whether there is another token than the one that was refused; asks for it once, however many calls wait. */
  private async hasOther(refused: string | undefined): Promise<boolean> {
    if (this.#token !== refused) return true;
    if (this.askToken === undefined) return false;
    this.asking ??= this.askToken(refused !== undefined).finally(() => (this.asking = undefined));
    const token = await this.asking;
    if (token !== undefined) this.#token = token;
    return token !== undefined;
  }

  private uploadWatched(
    path: string,
    body: Blob | FormData,
    type: string | undefined,
    call: Sent,
    onProgress: Progress,
    place: Place = { url: this.url },
    hops = 0,
  ): Promise<string> {
    const { signal, idempotencyKey, asked } = call;
    const headers = { ...this.#headers };
    const shown = this.show(headers);
    point(headers, place, hops);
    if (asked !== undefined) Object.assign(asked, { url: place.url, headers: signHeaders(headers) });
    return new Promise((resolve, reject) => {
      const request = new XMLHttpRequest();
      request.open("POST", place.url + path);
      request.setRequestHeader("accept", "application/json");
      for (const [name, value] of Object.entries(headers)) {
        request.setRequestHeader(name, value);
      }
      if (type !== undefined) {
        request.setRequestHeader("content-type", type);
      }
      if (idempotencyKey !== undefined) {
        request.setRequestHeader("idempotency-key", idempotencyKey);
      }
      request.upload.onprogress = (event) => event.total > 0 && onProgress(event.loaded / event.total);
      request.onload = () => {
        this.reached = true;
        const { status, statusText, responseText } = request;
        if (status >= 200 && status < 300) {
          resolve(responseText);
          return;
        }
        const there = this.places.told(status, (name) => request.getResponseHeader(name));
        if (there !== undefined && hops < MOST_HOPS) {
          this.uploadWatched(path, body, type, call, onProgress, there, hops + 1).then(resolve, reject);
          return;
        }
        const problem = problemOf(status, statusText, responseText, request.getResponseHeader("retry-after"));
        if (status !== 401) {
          reject(problem);
          return;
        }
        this.hasOther(shown)
          .then((other) => (other ? this.uploadWatched(path, body, type, call, onProgress, place, hops) : Promise.reject(problem)))
          .then(resolve, reject);
      };
      request.onerror = () => reject(unreachable(place.url, undefined));
      request.onabort = () => reject(signal?.reason ?? new DOMException("aborted", "AbortError"));
      signal?.addEventListener("abort", () => request.abort(), { once: true });
      request.send(body);
    });
  }
}

/** A server's address without slashes at its end. Fails when it is none. */
function addressOf(url: string): string {
  const refuse = (problem: string): never => {
    throw new PliantError("INVALID_ARGUMENT", `url: ${JSON.stringify(url)} ${problem}, such as http://127.0.0.1:7411`);
  };
  if (!/^https?:\/\//i.test(url)) refuse("does not begin with http:// or https://; write both, scheme and host");
  if (!URL.canParse(url)) refuse("is not an address; write scheme, host and port");
  return url.replace(/\/+$/, "");
}

/** Headers of a request for a sign of life: those of the call, without those of its body and its key. */
function signHeaders(headers: Record<string, string>): Record<string, string> {
  const { "content-type": _type, "idempotency-key": _key, ...rest } = headers;
  return rest;
}

/** Seconds that were given, 0 and more. */
function secondsOf(name: string, given: number): number {
  // Longer ones are none for the platform's timers, which would be over at once.
  if (given >= 0 && given <= 2_000_000) return given;
  throw new PliantError("INVALID_ARGUMENT", `${name}: ${given}, a number of seconds from 0 (without end) to 2000000 is allowed`);
}

/** Sets the headers of the node, for a proxy, and of the hops, for the server. */
function point(headers: Record<string, string>, { node }: Place, hops: number): void {
  headers["x-pliant-hops"] = String(hops);
  if (node === undefined) delete headers["x-pliant-node"];
  else headers["x-pliant-node"] = node;
}

/** A message as the JSON that the server reads. */
export function jsonOf<D extends DescMessage>(schema: D, message: Named<MessageInitShape<D>>): unknown {
  return toJson(schema, create(schema, numbered(schema, message)));
}

function parse<D extends DescMessage>(schema: D, body: string): MessageShape<D> {
  // A newer server may say more than this client knows.
  return fromJson(schema, JSON.parse(body), { ignoreUnknownFields: true });
}

/** A variable of the environment, where there is one. */
function environment(name: string): string | undefined {
  const { process } = globalThis as { process?: { env?: Record<string, string | undefined> } };
  return process?.env?.[name] || undefined;
}

/** The WebSocket of the package `ws`, where it is installed: node has none of its own before version 22. */
function socketOfNode(): typeof globalThis.WebSocket | undefined {
  const { process } = globalThis as { process?: { cwd(): string; getBuiltinModule?(name: string): Partial<Modules> | undefined } };
  const { createRequire } = process?.getBuiltinModule?.("module") ?? {};
  // A package that is linked into its user's does not see what lies beside it there.
  for (const from of createRequire === undefined ? [] : [import.meta.url, `${process?.cwd()}/package.json`]) {
    try {
      return createRequire?.(from)("ws") as typeof globalThis.WebSocket;
    } catch {
      // It is not there.
    }
  }
  return undefined;
}

interface Modules {
  createRequire(from: string): (name: string) => unknown;
}

/** A call that may be sent twice. */
function withKey<C extends CallOptions>(call: C): C {
  return { ...call, idempotencyKey: call.idempotencyKey ?? newKey() };
}

async function textOf(response: Response): Promise<string> {
  try {
    return await response.text();
  } catch (error) {
    throw unreachable("the server", error);
  }
}

function unreachable(what: string, error: unknown): unknown {
  if (error instanceof PliantError || (error instanceof Error && error.name === "AbortError")) {
    return error;
  }
  return new PliantError("UNREACHABLE", `${what} does not answer${hintFor(what)}`);
}

/** A browser hides from a page whether a server of another origin is away or rejects the page. */
function hintFor(url: string): string {
  const { window: page } = globalThis as { window?: { location?: { origin?: string } } };
  const origin = page?.location?.origin;
  if (origin === undefined || !URL.canParse(url) || new URL(url).origin === origin) return "";
  return `; if it runs, it may not answer pages of ${origin}: name that host in its cors_origins`;
}
