/** What the page shows, as signals: the interface reads them, the actions of this folder write them. */

import { computed, effect, signal } from "@preact/signals";
import type { PliantError, Session, StreamState, Topology, Vector, schema } from "pliant-client";
import type { HandleState } from "../model/handles.ts";
import type { SurfaceReport } from "../model/report.ts";
import { forPeople } from "../model/words.ts";
import { recall, store } from "./storage.ts";

/** The open model. */
export interface Document {
  readonly name: string;
  readonly session: Session;
  readonly topology: Topology;
  readonly report: SurfaceReport;
  /** Rest x, y, z of every render vertex. */
  readonly rest: Float32Array<ArrayBuffer>;
}

/** Something that takes a while. */
export interface Busy {
  readonly title: string;
  readonly detail?: string;
  /** 0 to 1; unknown without. */
  readonly fraction?: number;
  readonly cancel?: () => void;
}

/** A message. */
export interface Note {
  readonly id: number;
  readonly kind: "error" | "info";
  readonly title: string;
  readonly detail?: string;
}

export type Tool = "orbit" | "brush" | "box" | "lasso" | "part" | "move" | "rotate" | "scale" | "remesh" | "line";
export type Theme = "auto" | "dark" | "light";
export type Colouring = "handles" | "stretch" | "crossings" | "plain";

/** Which button looks around, whatever the tool. The other of the two pans. */
export type LooksWith = "middle" | "right";

/** What the last frames said. */
export interface Meters {
  readonly solveMs: number;
  readonly queueMs: number;
  readonly maxError: number;
  readonly residual: number;
  readonly bytes: number;
  /** Shapes painted in the last second of dragging. */
  readonly fps: number;
  readonly final: boolean;
}

/** What a user can choose and the page remembers. */
export interface Settings {
  readonly theme: Theme;
  readonly colouring: Colouring;
  readonly wire: boolean;
  /** Whether the model is shown as it looks; as clay otherwise. */
  readonly materials: boolean;
  readonly brushPixels: number;
  readonly throughSelect: boolean;
  /** Edge length that remeshing aims for, in model units; 0 = evens out only where stretch asks for it. */
  readonly remeshLength: number;
  readonly localAxes: boolean;
  readonly looksWith: LooksWith;
  readonly refineDragging: number;
  readonly refineCommit: number;
  readonly tolerance: number;
  readonly maxError: number;
  readonly progressive: boolean;
  readonly encoding: "AUTO" | "F32" | "U16" | "DELTA";
  readonly window: number;
  readonly firstPass: "HARMONIC" | "DIFFUSION" | "LINEAR_FRAMES";
  readonly method: "GRAPH" | "SPATIAL_RBF";
  readonly volumeMode: "AUTO" | "OFF" | "REQUIRED";
  readonly volumeInterval: number;
  readonly components: "FOLLOW" | "HOLD" | "FREE";
}

export const DEFAULTS: Settings = {
  theme: "auto",
  colouring: "handles",
  wire: false,
  materials: true,
  brushPixels: 28,
  throughSelect: false,
  remeshLength: 0,
  localAxes: false,
  looksWith: "middle",
  refineDragging: 0,
  refineCommit: 4,
  tolerance: 1e-4,
  maxError: 0,
  progressive: false,
  encoding: "AUTO",
  window: 2,
  firstPass: "HARMONIC",
  method: "GRAPH",
  volumeMode: "AUTO",
  volumeInterval: 0,
  components: "FOLLOW",
};

const STORED = "pliant.settings";

function remembered(): Settings {
  try {
    const stored: unknown = JSON.parse(recall("localStorage", STORED) ?? "{}");
    return { ...DEFAULTS, ...(typeof stored === "object" ? stored : {}) };
  } catch {
    return DEFAULTS;
  }
}

export const settings = signal<Settings>(remembered());
effect(() => store("localStorage", STORED, JSON.stringify(settings.value)));

/** Changes some settings. */
export function choose(change: Partial<Settings>): void {
  settings.value = { ...settings.peek(), ...change };
}

export const doc = signal<Document | undefined>(undefined);
export const facts = signal<schema.Session | undefined>(undefined);
export const handles = signal<readonly HandleState[]>([]);
/** The rotations that the recorded shape has for handles that turn freely, by id. */
export const foundTurns = signal<ReadonlyMap<string, Vector>>(new Map());
export const activeId = signal<string | undefined>(undefined);
export const activeHandle = computed(() => handles.value.find((handle) => handle.id === activeId.value));
/** 1 for every selected render vertex. */
export const selection = signal<Uint8Array>(new Uint8Array());
export const selectedCount = computed(() => selection.value.reduce((sum, x) => sum + x, 0));
export const tool = signal<Tool>("brush");
export const busy = signal<Busy | undefined>(undefined);
export const notes = signal<readonly Note[]>([]);
export const link = signal<{ state: StreamState | "none"; reason?: PliantError }>({ state: "none" });
export const meters = signal<Meters | undefined>(undefined);
export const superseded = signal(0);
export const quality = signal<schema.Quality | undefined>(undefined);
export const commits = signal<readonly schema.Commit[]>([]);
export const currentRevision = signal(0n);
export const helpOpen = signal(false);
/** Commits that were sent and not answered yet. */
export const recording = signal(0);
/** Whether a handle is being dragged. */
export const dragging = signal(false);
/** Whether a selection is being drawn. */
export const drawing = signal(false);
/** The plane of the cut that is being prepared: model-space normal and offset. */
export const cutPlane = signal<{ normal: [number, number, number]; offset: number } | undefined>(undefined);
/** Whether this server edits; unknown until it was asked. */
export const editsRefused = signal<string | undefined>(undefined);

/** The commit that the current topology comes from: the last edit, or the opening. */
export const topologyRevision = computed(() => {
  const past = commits.value.filter(({ revision }) => revision <= currentRevision.value);
  return past.findLast(({ kind }) => kind === "edit")?.revision ?? past[0]?.revision ?? 0n;
});

export const canUndo = computed(() => {
  const list = commits.value;
  return list.length > 0 && list[0]?.revision !== currentRevision.value;
});
export const canRedo = computed(() => commits.value.length > 0 && commits.value.at(-1)?.revision !== currentRevision.value);

let notesMade = 0;

/** Adds a message, for as long as `Notes` shows it. */
export function note(kind: Note["kind"], title: string, detail?: string): void {
  const id = ++notesMade;
  const told: Note = { id, kind, title, ...(detail === undefined ? {} : { detail }) };
  notes.value = [...notes.peek().filter((n) => n.title !== title || n.detail !== detail), told].slice(-4);
}

/** The note that says what was undone or done again: there is one, of the last. */
let travelled = 0;

/** Shows what was undone or redone. */
export function noteTravel(way: "Undone" | "Redone", what: string): void {
  dismiss(travelled);
  note("info", `${way}: ${what}`);
  travelled = notesMade;
}

export function dismiss(id: number): void {
  notes.value = notes.peek().filter((n) => n.id !== id);
}

/** What failed before no longer matters. */
export function dismissErrors(): void {
  notes.value = notes.peek().filter(({ kind }) => kind !== "error");
}

/** Shows why something failed, in the server's words where they apply here. */
export function fail(what: string, error: unknown): void {
  if (error instanceof Error && error.name === "AbortError") return;
  note("error", what, forPeople(error instanceof Error ? error.message : String(error)));
}
