/** Opening models: files, the sample, open sessions, and the same model again after the server forgot it. */

import {
  Client,
  type CreateOptions,
  type PlacedFile,
  PliantError,
  type Session,
  companionsOf,
  schema,
  type Topology,
} from "pliant-client";
import { batch } from "@preact/signals";
import type { HandleState } from "../model/handles.ts";
import { type SurfaceReport, reportOf } from "../model/report.ts";
import { Surface } from "../scene/surface.ts";
import { startStream, stopStream } from "./dragging.ts";
import { dress } from "./dressing.ts";
import { showsRevision } from "./following.ts";
import { adoptHandles, sampleHandles, setAllHandles } from "./handling.ts";
import { bringBack } from "./intermission.ts";
import { type Kept, forget, keep, kept, markOf } from "./keeping.ts";
import { type Leaving, askLeaving } from "./leaving.ts";
import { forgetPast, pastNames, pastSnapshots, refreshHistory, remember } from "./past.ts";
import { setCompanions } from "./playing.ts";
import * as s from "./signals.ts";
import { beginHere } from "./steps.ts";
import { recall, store } from "./storage.ts";
import { askToken, keptToken } from "./token.ts";
import { view } from "./view.ts";

const token = keptToken();

export const client = new Client({ askToken, ...(token === undefined ? {} : { token }) });

/** Extensions that name a model; other files dropped with it are its companions. */
export const EXTENSIONS = ["glb", "vrm", "gltf", "obj", "ply", "off", "stl", "3mf", "fbx", "splat", "spz"] as const;

/** Where the open model came from. */
type Source = Pick<Kept, "name" | "model" | "companions" | "sample">;

let source: Source | undefined;
let create: CreateOptions = {};
let beforeEdits: readonly HandleState[] | undefined;
/** Rest shapes by the commit that made their topology, so that undo across an edit finds the one before. */
const rests = new Map<bigint, Float32Array<ArrayBuffer>>();
const THIS_TAB = "pliant.session";
/** Coordinates, in model units, up to which a model is drawn: graphics squares lengths in 32-bit numbers. */
const LARGEST_DRAWN = 1e16;

/** What a session's shape is drawn from. */
interface Drawable {
  readonly topology: Topology;
  readonly report: SurfaceReport;
}

/** How the session is to be built, by the settings. */
export function createOptions(name: string): CreateOptions {
  const { volumeMode, volumeInterval, components } = s.settings.peek();
  return {
    label: name.slice(0, 80),
    volumeGraph: { mode: schema.CreateOptions_VolumeGraph_Mode[volumeMode], interval: volumeInterval },
    components: schema.CreateOptions_Components[components],
  };
}

/** Opens what was dropped or picked: one model, and the files it refers to. */
export async function openFiles(files: readonly PlacedFile[]): Promise<void> {
  const nameOf = ({ path }: PlacedFile): string => path.split("/").at(-1) ?? path;
  const kind = (file: PlacedFile): string => nameOf(file).split(".").at(-1)?.toLowerCase() ?? "";
  const models = files.filter((file) => (EXTENSIONS as readonly string[]).includes(kind(file)));
  // A .gltf names other files; no other format takes a second model along.
  const model = models.find((file) => kind(file) === "gltf") ?? models[0];
  if (model === undefined) {
    s.dismissErrors();
    const seen = files.slice(0, 20).map(nameOf).join(", ") || "nothing";
    s.note("error", "Not a model", `${seen}: the server reads ${EXTENSIONS.join(", ")}.`);
    return;
  }
  if (models.length > 1) {
    s.note("info", `Opened ${nameOf(model)}`, "You gave several models; a session takes one.");
  }
  const leaving = await askLeaving();
  if (leaving === "stay") return;
  const companions = await companionsOf(model, files.filter((file) => file !== model));
  await open({ name: nameOf(model), model: model.file, companions, sample: false }, undefined, leaving);
}

/** Opens the built-in creature, its feet and head already handles. */
export async function openSample(): Promise<void> {
  await open({ name: "creature", model: undefined, companions: new Map(), sample: true });
}

/** Builds the open model again with the options chosen since; handles stay. */
export async function rebuild(): Promise<void> {
  if (source !== undefined) await open(source, beforeEdits ?? s.handles.peek());
}

/** Whether the open model can be uploaded again. */
export function canRebuild(): boolean {
  return source !== undefined && (source.sample || source.model !== undefined);
}

/** Opens the model that was open before, with its handles and poses. */
export async function reopen(last: Kept): Promise<void> {
  await open(last, last.beforeEdits ?? last.handles);
  const now = s.doc.peek()?.session.id;
  if (now !== undefined && now !== last.session) await forget(last.session);
}

/** Reopens the model on the screen, as it is now: the server may have gone before it received the last pose. */
export async function reopenShown(): Promise<void> {
  const shown = documentNow();
  if (shown === undefined) return;
  // The file on the disk may have changed since it was opened; the browser's own copy has not.
  const found = await kept(shown.session);
  await reopen(found?.model === undefined ? shown : { ...shown, model: found.model, companions: found.companions });
}

/** Takes up a session that is open on the server. */
export async function resume(id: string): Promise<boolean> {
  const known = await kept(id);
  let found = false;
  await busily("Opening the session", async (signal) => {
    const session = await client.session(id, { signal }).catch((error: unknown) => {
      // Gone is no failure: the start page offers to open the same model again.
      if (error instanceof PliantError && error.isGone) return undefined;
      throw error;
    });
    if (session === undefined) {
      leave();
      return;
    }
    found = true;
    const drawn = await drawable(session);
    source = known ?? { name: session.facts.label || "model", model: undefined, companions: new Map(), sample: false };
    create = known?.create ?? {};
    beforeEdits = known?.beforeEdits;
    rests.clear();
    forgetPast(known?.past, known?.names);
    show(session, source.name, drawn, known?.rest);
    adoptHandles(session.facts, known?.handles);
    await refreshHistory();
    beginHere();
    s.tool.value = s.handles.peek().length > 0 ? "move" : "brush";
  });
  return found;
}

/** Closes the model. The session goes with it, unless something was done in it and the user keeps it. */
export async function closeModel(): Promise<void> {
  const leaving = await askLeaving();
  if (leaving === "stay") return;
  const open = s.doc.peek();
  if (leaving === "keep") await keepDocument();
  leave();
  if (open === undefined || leaving === "keep") return;
  void forget(open.session.id);
  await open.session.close().catch(() => undefined);
}

/** Writes down what a reload or a restart of the server needs. */
export async function keepDocument(): Promise<void> {
  const now = documentNow();
  if (now !== undefined) await keep({ ...now, owner: await markOf(keptToken()) });
}

/** The open model as it is now, with what it takes to reopen it. */
export function documentNow(): Kept | undefined {
  const open = s.doc.peek();
  if (open === undefined || source === undefined) return undefined;
  const { name, model, companions, sample } = source;
  const [past, names] = [pastSnapshots(), pastNames()];
  const handles = s.handles.peek();
  return { session: open.session.id, name, model, companions, sample, create, rest: open.rest, handles, past, names, beforeEdits };
}

/** An edit is about to change the topology: handles as they are now are the last that fit the uploaded file. */
export function holdBeforeEdits(): void {
  beforeEdits ??= s.handles.peek();
}

/** The topology is about to be another: its rest shape is needed when undo or redo come back to it. */
export function holdRest(): void {
  const open = s.doc.peek();
  if (open !== undefined) rests.set(s.topologyRevision.peek(), open.rest);
}

/** Draws the session's shape as it is now, after its topology changed and the history was asked for. */
export async function reload(session: Session, name: string): Promise<void> {
  show(session, name, await drawable(session), rests.get(s.topologyRevision.peek()), false);
}

async function open(from: Source, restored?: readonly HandleState[], leaving: Leaving = "discard"): Promise<void> {
  await busily(from.sample ? "Opening the creature" : `Opening ${from.name}`, async (signal, tell) => {
    const options = createOptions(from.name);
    const previous = s.doc.peek()?.session;
    let session: Session;
    if (from.sample) {
      session = await client.sample({ create: options, signal });
    } else if (from.model === undefined) {
      throw new PliantError("NOT_FOUND", "the page no longer has the file; open it again from your disk");
    } else {
      const onProgress = (fraction: number): void =>
        fraction < 1 ? tell("Uploading", fraction) : tell("The server builds the solver");
      tell("Uploading", 0);
      session = await client.open(from.model, { create: options, companions: from.companions, signal, onProgress });
    }
    tell("Fetching the triangles");
    const drawn = await drawable(session).catch((error: unknown) => {
      // Nobody would find the session again.
      void session.close().catch(() => undefined);
      throw error;
    });
    source = from;
    create = options;
    beforeEdits = undefined;
    rests.clear();
    forgetPast();
    show(session, from.name, drawn, undefined, restored === undefined);
    if (previous !== undefined && leaving === "discard") {
      void forget(previous.id);
      void previous.close().catch(() => undefined);
    }
    remember(session.facts.revision, []);
    const wanted = restored ?? (from.sample ? sampleHandles(s.doc.peek()) : []);
    if (wanted.length > 0) await setAllHandles(wanted);
    await refreshHistory();
    beginHere();
    s.tool.value = wanted.length > 0 ? "move" : "brush";
  });
}

/** Fetches the triangles; refuses what cannot be drawn. */
async function drawable(session: Session): Promise<Drawable> {
  const topology = await session.topology();
  const report = reportOf(topology);
  const reach = Math.max(...[...report.box.min, ...report.box.max].map(Math.abs));
  if (reach > LARGEST_DRAWN) {
    const limit = LARGEST_DRAWN.toExponential();
    throw new PliantError("OUT_OF_RANGE", `coordinates reach ${reach.toExponential(1)}, this page draws up to ${limit}; scale the model down`);
  }
  return { topology, report };
}

function show(session: Session, name: string, { topology, report }: Drawable, rest?: Float32Array<ArrayBuffer>, frame = true): void {
  const fits = rest !== undefined && rest.length === topology.positions.length;
  const atRest = fits ? rest : topology.positions;
  const { stage, gizmo, pointer } = view();
  stopStream();
  bringBack();
  gizmo.attach(undefined, undefined);
  const surface = new Surface(topology, report, atRest);
  // Before the signals: what watches them finds the new surface.
  stage.show(surface, frame);
  pointer.hide();
  batch(() => {
    s.doc.value = { name, session, topology, report, rest: atRest };
    s.facts.value = session.facts;
    showsRevision(session.facts.revision);
    s.handles.value = [];
    s.activeId.value = undefined;
    s.selection.value = new Uint8Array(topology.positions.length / 3);
    s.meters.value = undefined;
    s.quality.value = undefined;
    s.superseded.value = 0;
    s.cutPlane.value = undefined;
  });
  startStream(session);
  const companions = source?.companions ?? new Map<string, Blob>();
  setCompanions(companions);
  void dress(surface, session, companions);
  store("sessionStorage", THIS_TAB, session.id);
  void keepDocument();
}

/** The session that this tab had open before it was reloaded. */
export function sessionOfThisTab(): string | undefined {
  return new URLSearchParams(location.search).get("session") ?? recall("sessionStorage", THIS_TAB);
}

/** Goes back to the start page without touching the server. */
export function leave(): void {
  stopStream();
  bringBack();
  source = undefined;
  const { stage, gizmo, markers } = view();
  gizmo.attach(undefined, undefined);
  markers.show([]);
  batch(() => {
    s.doc.value = undefined;
    s.facts.value = undefined;
    s.handles.value = [];
    s.activeId.value = undefined;
    s.selection.value = new Uint8Array();
    s.commits.value = [];
    s.link.value = { state: "none" };
  });
  stage.show(undefined, false);
  store("sessionStorage", THIS_TAB, undefined);
}

type Tell = (detail: string, fraction?: number) => void;

/** Runs something under the busy sign; shows failures. */
async function busily(title: string, work: (signal: AbortSignal, tell: Tell) => Promise<void>): Promise<void> {
  const abort = new AbortController();
  const cancel = (): void => abort.abort();
  s.busy.value = { title, cancel };
  // Another attempt makes those before it old.
  s.dismissErrors();
  try {
    await work(abort.signal, (detail, fraction) => {
      s.busy.value = { title, detail, cancel, ...(fraction === undefined ? {} : { fraction }) };
    });
  } catch (error) {
    s.fail(`${title} failed`, error);
  } finally {
    s.busy.value = undefined;
  }
}
