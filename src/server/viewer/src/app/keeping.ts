/**
 * What outlives a reload of the page: the last model with its handles, in the browser's own database. Sessions live on
 * the server; this is what is needed to take one up again, or to open the same model anew after the server forgot it.
 */

import type { CreateOptions } from "pliant-client";
import type { HandleState } from "../model/handles.ts";

/** The last model. */
export interface Kept {
  readonly session: string;
  readonly name: string;
  /** The file, or nothing for the built-in creature and for sessions opened elsewhere. */
  readonly model: Blob | undefined;
  readonly companions: ReadonlyMap<string, Blob>;
  readonly sample: boolean;
  readonly create: CreateOptions;
  /** x, y, z at rest. */
  readonly rest: Float32Array<ArrayBuffer>;
  /** Handles as they are now, and by revision. */
  readonly handles: readonly HandleState[];
  readonly past: ReadonlyMap<string, readonly HandleState[]>;
  /** Handles before the first edit: what can be set again on the model as it was uploaded. */
  readonly beforeEdits: readonly HandleState[] | undefined;
}

const STORE = "last";
const KEY = "model";
/** Larger models are not kept: the browser may refuse, and the user would not notice why the page is slow. */
const LARGEST = 256 << 20;

/** Whether something can be opened anew from what was kept. */
export function canReopen(kept: Kept): boolean {
  return kept.sample || kept.model !== undefined;
}

/** Remembers a model. Failing to is no failure of the page. */
export async function keep(kept: Kept): Promise<void> {
  const tooLarge = (kept.model?.size ?? 0) > LARGEST;
  await withStore("readwrite", (store) => store.put(tooLarge ? { ...kept, model: undefined } : kept, KEY));
}

/** The model remembered last. */
export async function kept(): Promise<Kept | undefined> {
  return (await withStore<Kept | undefined>("readonly", (store) => store.get(KEY))) ?? undefined;
}

export async function forget(): Promise<void> {
  await withStore("readwrite", (store) => store.delete(KEY));
}

async function withStore<T>(
  mode: IDBTransactionMode,
  act: (store: IDBObjectStore) => IDBRequest,
): Promise<T | undefined> {
  try {
    const database = await request<IDBDatabase>(opened());
    try {
      return await request<T>(act(database.transaction(STORE, mode).objectStore(STORE)));
    } finally {
      database.close();
    }
  } catch {
    // Private windows and full disks: the page works, it only forgets.
    return undefined;
  }
}

function opened(): IDBOpenDBRequest {
  const opening = indexedDB.open("pliant-viewer", 1);
  opening.onupgradeneeded = () => opening.result.createObjectStore(STORE);
  return opening;
}

function request<T>(asked: IDBRequest): Promise<T> {
  return new Promise((resolve, reject) => {
    asked.onsuccess = () => resolve(asked.result as T);
    asked.onerror = () => reject(asked.error);
  });
}
