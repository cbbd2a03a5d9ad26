/**
 * What outlives a reload of the page: the last models with their handles, in the browser's own database, one record for
 * each session, so that tabs do not write over each other's. Sessions live on the server; this is what it takes to
 * resume one, or to reopen the same model after the server forgot it.
 */

import type { CreateOptions } from "pliant-client";
import type { HandleState } from "../model/handles.ts";

/** The model of a session. */
export interface Kept {
  readonly session: string;
  readonly name: string;
  /** The file, or nothing for the built-in creature and for sessions opened elsewhere. */
  readonly model: Blob | undefined;
  readonly companions: ReadonlyMap<string, Blob>;
  readonly sample: boolean;
  readonly create: CreateOptions;
  /** Rest positions. */
  readonly rest: Float32Array<ArrayBuffer>;
  /** Handles as they are now, and by revision. */
  readonly handles: readonly HandleState[];
  readonly past: ReadonlyMap<string, readonly HandleState[]>;
  /** What made each revision, in words; absent in records of former versions of the page. */
  readonly names?: ReadonlyMap<string, string>;
  /** Whose it is: `markOf` the token with which it was opened; absent in records of former versions of the page. */
  readonly owner?: string;
  /** Handles before the first edit: what can be set again on the model as it was uploaded. */
  readonly beforeEdits: readonly HandleState[] | undefined;
}

const DATABASE = "pliant-viewer";
const STORE = "models";
/** The owner of models that were opened without a token. */
const NOBODY = "";
/** Orders records by when they were written. */
const BY_TIME = "keptAt";
/** What the first version of the database had: one record for all tabs. */
const FORMER = { store: "last", key: "model" } as const;
/** Records that stay; older ones go. */
const MOST = 8;
/** Larger models are not kept: the browser may refuse, and the user would not notice why the page is slow. */
const LARGEST = 256 << 20;

/** Whether a record suffices to reopen its model. */
export function canReopen(kept: Kept): boolean {
  return kept.sample || kept.model !== undefined;
}

/** An identifier of the token's owner, which reveals nothing of the token. */
export async function markOf(token: string | undefined): Promise<string> {
  if (token === undefined) return NOBODY;
  const { subtle } = globalThis.crypto as Partial<Crypto>;
  // A page from afar without TLS has no digests: what is kept there is shown to nobody.
  if (subtle === undefined) return `unknown ${Math.random()}`;
  const digest = await subtle.digest("SHA-256", new TextEncoder().encode(`pliant.viewer ${token}`));
  return Array.from(new Uint8Array(digest), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Stores a model. The page ignores a failure. */
export async function keep(kept: Kept): Promise<void> {
  const tooLarge = (kept.model?.size ?? 0) > LARGEST;
  const record = { ...kept, [BY_TIME]: Date.now(), ...(tooLarge ? { model: undefined } : {}) };
  const put = (): Promise<unknown> => withStore("readwrite", (store) => store.put(record));
  // The newest model matters most: where there is no room for it, the others go.
  if ((await put()) === undefined) {
    await trim(0);
    await put();
  }
  await trim(MOST);
}

/** The model of this session. */
export function kept(session: string): Promise<Kept | undefined> {
  return withStore<Kept>("readonly", (store) => store.get(session));
}

/** All models of this owner with when they were written (milliseconds since 1970), the newest first. */
export async function allKept(owner: string): Promise<readonly (Kept & { readonly keptAt: number })[]> {
  const all = await withStore<(Kept & { readonly keptAt: number })[]>("readonly", (store) => store.index(BY_TIME).getAll());
  // Whoever has another token, or none, is not told of models that were opened with one.
  return (all ?? []).filter((record) => (record.owner ?? NOBODY) === owner).reverse();
}

export async function forget(session: string): Promise<void> {
  await withStore("readwrite", (store) => store.delete(session));
}

/** Sessions with a record, the newest last. */
async function sessions(): Promise<readonly string[]> {
  return (await withStore<string[]>("readonly", (store) => store.index(BY_TIME).getAllKeys())) ?? [];
}

async function trim(most: number): Promise<void> {
  const all = await sessions();
  for (const session of all.slice(0, Math.max(0, all.length - most))) await forget(session);
}

async function withStore<T>(
  mode: IDBTransactionMode,
  act: (store: IDBObjectStore) => IDBRequest,
): Promise<T | undefined> {
  try {
    const database = await request<IDBDatabase>(opened());
    try {
      const transaction = database.transaction(STORE, mode);
      // A full disk is told by the transaction, after the request succeeded.
      const stored = new Promise((resolve, reject) => {
        transaction.oncomplete = resolve;
        transaction.onabort = () => reject(transaction.error);
      });
      const [answer] = await Promise.all([request<T>(act(transaction.objectStore(STORE))), stored]);
      return answer;
    } finally {
      database.close();
    }
  } catch {
    // Private windows and full disks: the page works, it only forgets.
    return undefined;
  }
}

function opened(): IDBOpenDBRequest {
  const opening = indexedDB.open(DATABASE, 2);
  opening.onupgradeneeded = () => {
    const { result: database, transaction } = opening;
    const store = database.createObjectStore(STORE, { keyPath: "session" satisfies keyof Kept });
    store.createIndex(BY_TIME, BY_TIME);
    if (!database.objectStoreNames.contains(FORMER.store)) return;
    const former: IDBRequest<Kept | undefined> | undefined = transaction?.objectStore(FORMER.store).get(FORMER.key);
    if (former === undefined) return;
    former.onsuccess = () => {
      if (former.result !== undefined) store.put({ ...former.result, [BY_TIME]: Date.now() });
      database.deleteObjectStore(FORMER.store);
    };
  };
  return opening;
}

function request<T>(asked: IDBRequest): Promise<T> {
  return new Promise((resolve, reject) => {
    asked.onsuccess = () => resolve(asked.result as T);
    asked.onerror = () => reject(asked.error);
  });
}
