/** One open session: its handles, committed poses, edits, history and exports, and its stream. */

import { create, type MessageInitShape } from "@bufbuild/protobuf";
import type { CrossingsResponse, EditResult, HistoryResponse, MakeRigResponse, Quality, Session as Facts, Work } from "./gen/pliant/v1/pliant_pb.js";
import {
  CarryRequestSchema,
  CarryResponseSchema,
  type CarryResponse,
  CrossingsRequestSchema,
  CrossingsResponseSchema,
  type EditRequest_AdoptSchema,
  EditRequest_On,
  EditRequestSchema,
  EditRequest_WrapSchema,
  EditResultSchema,
  HandleSchema,
  HistoryResponseSchema,
  MakeRigRequestSchema,
  MakeRigResponseSchema,
  OptionsSchema,
  Pose_EntrySchema,
  QualitySchema,
  SessionSchema,
  SetHandlesRequestSchema,
  SolveRequestSchema,
  TransferRequestSchema,
} from "./gen/pliant/v1/pliant_pb.js";
import type { AnimateOptions } from "./animation.js";
import { Animation, formOf } from "./animation.js";
import { newKey } from "./attempts.js";
import { PliantError } from "./errors.js";
import { originOf } from "./frames.js";
import type { Named } from "./names.js";
import { checkPoses, littleEndian } from "./poses.js";
import { type RegionLike, regionFrom } from "./regions.js";
import type { Vector } from "./rotation.js";
import type { StreamEvents } from "./stream.js";
import { Stream } from "./stream.js";
import { type Topology, amongAll, readTopology, topologyFormat } from "./topology.js";
import type { CallOptions, Transport } from "./transport.js";
import { jsonOf } from "./transport.js";

/** A handle: a region, and what is done with it. */
export type Handle = Named<Omit<MessageInitShape<typeof HandleSchema>, "region" | "$typeName">> & { region?: RegionLike };
export type SolveOptions = Named<MessageInitShape<typeof OptionsSchema>>;
export type PoseEntry = MessageInitShape<typeof Pose_EntrySchema>;
/** All handles of a session. */
export type SetHandles = Omit<MessageInitShape<typeof SetHandlesRequestSchema>, "sessionId" | "$typeName" | "handles" | "regionOfInterest"> & {
  handles?: readonly Handle[];
  /** Everything outside of it stays bit-identical. */
  regionOfInterest?: RegionLike;
};
export type Edit = Named<Omit<MessageInitShape<typeof EditRequestSchema>, "sessionId" | "$typeName">>;

/** How a model is wrapped onto another one. */
export type WrapOptions = Named<Omit<MessageInitShape<typeof EditRequest_WrapSchema>, "target" | "$typeName">>;

/** How shapes come from another model. `shape`: that model in another shape. */
export type TransferOptions = Omit<MessageInitShape<typeof TransferRequestSchema>, "source" | "sessionId" | "$typeName">;

/** How a call is made whose work may take long. */
export interface WorkOptions extends CallOptions {
  /** Called some times a second with what the server works on, and how much of it is done. `signal` gives the call up. */
  onWork?: (work: Work) => void;
}

/** Milliseconds between looks at how far the server is. */
const GLANCE_MS = 250;

/** Fields of a handle that can be cleared. */
export type HandleField = "constrains" | "stiffness" | "rigid" | "pose" | "falloff";

/** What a rig is made for; what is absent is found. */
export interface RigOrder {
  /** A BVH file: its first three frames are enough. */
  readonly bvh?: Uint8Array;
  /** Without a recording, whose names joints have. */
  readonly preset?: "cmu" | "mixamo";
  /** Places of joints by name. They stay, and joints that depend on them follow. */
  readonly joints?: Readonly<Record<string, Vector>>;
  /** From the figure's feet to its head, such as "z" or "-y", and where it faces. */
  readonly up?: string;
  readonly front?: string;
}

/** Formats that a model can be had in. */
export type Format = "glb" | "vrm" | "gltf" | "obj" | "ply" | "off" | "stl" | "3mf" | "splat" | "spz";

/** A committed pose as a bare buffer. */
export interface Solved {
  /** x, y, z per render vertex, relative to `Session.origin`. */
  readonly positions: Float32Array<ArrayBuffer>;
  readonly revision: number;
  /** Digest of the positions: equal digests are equal bits. */
  readonly digest: string;
  readonly residual: number;
  readonly maxError: number;
  readonly solveMs: number;
  /** The shape against the rest shape. */
  readonly quality: Quality;
}

/** Points carried along with a shape, in the order in which they were given. */
export interface Carried {
  /** x, y, z of each point now. */
  readonly points: Float64Array;
  /** The axes at each point now: unit quaternions x, y, z, w. */
  readonly rotations: Float64Array;
  /** How many times as large lengths around each point are now. */
  readonly scales: Float64Array;
  readonly revision: number;
}

/** A model file carried along with a shape. */
export type CarriedModel = Pick<CarryResponse, "model" | "warnings">;

/** A session that is open on the server. Every method calls the server; `facts` is its last answer. */
export class Session {
  /** The newest revision that a call returned. */
  private known: number;

  constructor(
    private readonly transport: Transport,
    /** The session as the server described it last. */
    public facts: Facts,
  ) {
    this.known = Number(facts.revision);
  }

  get id(): string {
    return this.facts.id;
  }

  toString(): string {
    const { label, model } = this.facts;
    return `Session ${label === "" ? "" : `${JSON.stringify(label)} `}${this.id}: ${model?.vertices ?? 0} vertices, revision ${this.known}`;
  }

  /** What node's console shows. */
  [Symbol.for("nodejs.util.inspect.custom")](): string {
    return this.toString();
  }

  /** Updates `facts`, and renews the session's expiry. */
  refresh(call: CallOptions = {}): Promise<Facts> {
    return this.told(this.transport.message(SessionSchema, "GET", this.path(""), call));
  }

  /** Replaces all handles. One commit. */
  async setHandles(handles: SetHandles, call: CallOptions = {}): Promise<Facts> {
    const { handles: several = [], regionOfInterest, ...rest } = handles;
    const interest = regionOfInterest && { regionOfInterest: regionFrom(regionOfInterest) };
    const json = jsonOf(SetHandlesRequestSchema, { ...rest, ...interest, handles: several.map(handleFrom) });
    return this.told(this.transport.message(SessionSchema, "PUT", this.path("/handles"), { ...call, json }));
  }

  /**
   * Adds a handle, or replaces the given fields of the one with this id; those in `clear` go back to their default, so
   * `clear: ["stiffness"]` makes a soft handle hard. One commit.
   */
  async putHandle(handle: Handle & { id: string }, call: CallOptions & { clear?: readonly HandleField[] } = {}): Promise<Facts> {
    const cleared = Object.fromEntries((call.clear ?? []).map((field) => [field, null]));
    const json = { ...(jsonOf(HandleSchema, handleFrom(handle)) as object), ...cleared };
    const path = this.path(`/handles/${encodeURIComponent(handle.id)}`);
    return this.told(this.transport.message(SessionSchema, "PATCH", path, { ...call, json }));
  }

  /** Removes a handle. One commit. */
  removeHandle(id: string, call: CallOptions = {}): Promise<Facts> {
    const path = this.path(`/handles/${encodeURIComponent(id)}`);
    return this.told(this.transport.message(SessionSchema, "DELETE", path, call));
  }

  /** Solves one pose, commits it, and answers the whole buffer. */
  async solve(handles: PoseEntry[], options: SolveOptions = {}, call: CallOptions = {}): Promise<Solved> {
    checkPoses(handles);
    const json = jsonOf(SolveRequestSchema, { pose: { handles }, options });
    const read = async (response: Response) => ({ headers: response.headers, bytes: await response.arrayBuffer() });
    const accept = "application/octet-stream";
    const { headers, bytes } = await this.transport.read("POST", this.path("/solve"), accept, { ...call, json }, read);
    const fact = (name: string): string => headers.get(`x-pliant-${name}`) ?? "";
    const pairs = headers.get("x-pliant-self-intersections");
    const off = headers.get("x-pliant-off-rigid");
    const quality = create(QualitySchema, {
      edgeRms: Number(fact("edge-rms")),
      volumeChange: Number(fact("volume-change")),
      openSurface: fact("open-surface") === "true",
      areaChange: Number(fact("area-change")),
      flippedTriangles: Number(fact("flipped-triangles")),
      maxStretch: Number(fact("max-stretch")),
      facesTooLarge: Number(fact("faces-too-large")),
      ...(pairs === null ? {} : { selfIntersections: Number(pairs) }),
      ...(off === null ? {} : { offRigid: Number(off) }),
    });
    return {
      positions: new Float32Array(bytes),
      revision: Number(fact("revision")),
      digest: fact("digest"),
      residual: Number(fact("residual")),
      maxError: Number(fact("max-error")),
      solveMs: Number(fact("solve-ms")),
      quality,
    };
  }

  /** Goes back by one commit. */
  undo(call: CallOptions = {}): Promise<Facts> {
    return this.told(this.transport.message(SessionSchema, "POST", this.path("/undo"), call));
  }

  /** Goes forward again by one undone commit. */
  redo(call: CallOptions = {}): Promise<Facts> {
    return this.told(this.transport.message(SessionSchema, "POST", this.path("/redo"), call));
  }

  /** The commits, oldest first. */
  history(call: CallOptions = {}): Promise<HistoryResponse> {
    return this.transport.message(HistoryResponseSchema, "GET", this.path("/history"), call);
  }

  /** Changes the topology. One commit. */
  async edit(edit: Edit, { onWork, ...call }: WorkOptions = {}): Promise<EditResult> {
    const json = jsonOf(EditRequestSchema, edit);
    const answer = this.transport.message(EditResultSchema, "POST", this.path("/edits"), { ...call, json });
    const result = await this.watching(answer, onWork);
    this.known = Math.max(this.known, Number(result.revision));
    return result;
  }

  /** Waits for a call, and reports how far the server is with it. */
  private async watching<T>(answer: Promise<T>, onWork: WorkOptions["onWork"]): Promise<T> {
    if (onWork === undefined) return answer;
    let isOver = false;
    const look = async (): Promise<void> => {
      const { work } = await this.transport.probe(SessionSchema, this.path(""));
      if (!isOver && work !== undefined) onWork(work);
    };
    // That nothing is known of it ends no call.
    const glances = setInterval(() => void look().catch(() => undefined), GLANCE_MS);
    try {
      return await answer;
    } finally {
      isOver = true;
      clearInterval(glances);
    }
  }

  /**
   * Makes a shape the rest pose, from which poses go on: the current one, or x, y, z of each vertex (or of each but those of passengers),
   * relative to `origin` as frames are. They hold bit for bit; rig, skins, morph targets and passengers follow. One commit, in parts
   * where it is large.
   */
  async adopt(positions?: Float32Array, on: "CURRENT" | "REST" = "CURRENT", call: CallOptions = {}): Promise<EditResult> {
    const edit = (adopt: MessageInitShape<typeof EditRequest_AdoptSchema>) =>
      this.edit({ on: EditRequest_On[on], operation: { case: "adopt", value: adopt } }, call);
    if (positions === undefined) return edit({});
    const part = 3 * 65536;
    const shape = positions.length > part ? newKey() : "";
    for (let first = 0; first + part < positions.length; first += part) {
      await edit({ positions: littleEndian(positions.subarray(first, first + part)), first: first / 3, more: true, shape });
    }
    const first = Math.max(0, Math.ceil(positions.length / part) - 1) * part;
    return edit({ positions: littleEndian(positions.subarray(first)), first: first / 3, shape });
  }

  /**
   * Moves all vertices so that the surface lies on that of a model file, or of another session: topology, texture coordinates, rig and
   * morph targets follow. One commit. `wrap` of the result says how well it lies.
   */
  wrap(target: Uint8Array | { session: string }, options: WrapOptions = {}, call: WorkOptions = {}): Promise<EditResult> {
    const isFile = target instanceof Uint8Array;
    const source = isFile ? { case: "model" as const, value: target } : { case: "session" as const, value: target.session };
    return this.edit({ operation: { case: "wrap", value: { ...options, target: source } } }, call);
  }

  /**
   * The model with the blend shapes of another one, a file or another session, as a GLB; with `shape`, that model in another shape, the
   * model in the shape that it takes on by it; with `fit` too, the model, an outfit of the other one, on the body that `shape` is. Nothing
   * changes.
   */
  transfer(source: Uint8Array | { session: string }, options: TransferOptions = {}, { onWork, ...call }: WorkOptions = {}): Promise<Blob> {
    const isFile = source instanceof Uint8Array;
    const from = isFile ? { case: "model" as const, value: source } : { case: "session" as const, value: source.session };
    const json = jsonOf(TransferRequestSchema, { ...options, source: from });
    return this.watching(this.transport.read("POST", this.path("/transfer"), "*/*", { ...call, json }, blobOf), onWork);
  }

  /**
   * Drives the model by a clip: one of its own by name or number (absent, its first), or a BVH file with a rig. The frames come one by
   * one; the session's handles, shape and history stay as they are.
   */
  animate(options: AnimateOptions = {}, call: CallOptions = {}): Animation {
    const accept = "application/vnd.google.protobuf";
    const route = (body: FormData, how: CallOptions) =>
      this.transport.bytes("POST", this.path("/animations"), accept, { ...how, body });
    return new Animation(route, options, call);
  }

  /** As `animate`, as a GLB that plays the clip: with morph targets, or with `playedAs: "SKIN"` as a skin of rigid bones. */
  async animatedModel(options: AnimateOptions = {}, call: CallOptions = {}): Promise<Blob> {
    const body = formOf(options);
    return this.transport.read("POST", this.path("/animations"), "model/gltf-binary", { ...call, body }, blobOf);
  }

  /** What positions in buffers and frames are relative to; zero but for models far from the origin. `inModelSpace` adds it. */
  get origin(): Vector {
    return originOf(this.facts);
  }

  /** The current shape: x, y, z per render vertex, relative to `origin`. */
  async positions(call: CallOptions = {}): Promise<Float32Array<ArrayBuffer>> {
    const read = (response: Response) => response.arrayBuffer();
    return new Float32Array(await this.transport.read("GET", this.path("/positions"), "application/octet-stream", call, read));
  }

  /** The triangles, which stay the same until an edit, with the current `positions`, and normals where the model has them. */
  async topology(call: CallOptions = {}): Promise<Topology> {
    const { format, vertices = 0 } = this.facts.model ?? {};
    let topology = readTopology(await (await this.model(topologyFormat(format), call)).arrayBuffer(), this.origin);
    if (topology.positions.length !== vertices * 3) topology = amongAll(topology, await this.positions(call), this.facts.primitives);
    const seen = topology.positions.length / 3;
    if (seen !== vertices) throw new PliantError("INTERNAL", `the server reports ${vertices} vertices but sent ${seen}`);
    return topology;
  }

  /** The triangles: three rows of `positions` each. They stay the same until an edit. */
  async triangles(call: CallOptions = {}): Promise<Uint32Array<ArrayBuffer>> {
    return (await this.topology(call)).indices;
  }

  /** The model in its current shape. Without a format: the one it came in. */
  async model(format?: Format, call: CallOptions = {}): Promise<Blob> {
    const path = this.path(format === undefined ? "/model" : `/model?format=${format}`);
    return this.transport.read("GET", path, "*/*", call, blobOf);
  }

  /**
   * Carries points of the rest pose along with the current shape: on the model, in it or around it. `points` are x, y, z
   * of each in a row, `rotations` the axes at them as x, y, z, w. Nothing changes.
   */
  async carry(points: ArrayLike<number>, rotations: ArrayLike<number> = [], call: CallOptions = {}): Promise<Carried> {
    const json = jsonOf(CarryRequestSchema, { points: Array.from(points), rotations: Array.from(rotations) });
    const answer = await this.transport.message(CarryResponseSchema, "POST", this.path("/carry"), { ...call, json });
    return {
      points: Float64Array.from(answer.points),
      rotations: Float64Array.from(answer.rotations),
      scales: Float64Array.from(answer.scales),
      revision: Number(answer.revision),
    };
  }

  /**
   * Carries a model file, or Gaussian splats, that stand in the same rest pose, and answers it in its own format, with what of it may
   * not fit.
   */
  async carryModel(model: Uint8Array, format: Format | "splat" | "spz" | "" = "", call: CallOptions = {}): Promise<CarriedModel> {
    const json = jsonOf(CarryRequestSchema, { model, format });
    const answer = await this.transport.message(CarryResponseSchema, "POST", this.path("/carry"), { ...call, json });
    return { model: answer.model, warnings: answer.warnings };
  }

  /**
   * The triangles of the current shape that cross others, at most `limit` in each list (0: 100,000), and with `pairs` which two
   * cross, where and how deep. Nothing changes.
   */
  crossings(asked: { limit?: number; pairs?: boolean } = {}, call: CallOptions = {}): Promise<CrossingsResponse> {
    const json = jsonOf(CrossingsRequestSchema, asked);
    return this.transport.message(CrossingsResponseSchema, "POST", this.path("/crossings"), { ...call, json });
  }

  /** The rig that a recording, or a preset, drives the model by, and how sure its joints are. Nothing changes. */
  makeRig({ bvh, preset, joints = {}, up = "", front = "" }: RigOrder = {}, call: CallOptions = {}): Promise<MakeRigResponse> {
    const places = Object.fromEntries(Object.entries(joints).map(([name, at]) => [name, { at: [...at] }]));
    const source = bvh !== undefined ? { case: "bvh" as const, value: bvh } : preset !== undefined ? { case: "preset" as const, value: preset } : undefined;
    const json = jsonOf(MakeRigRequestSchema, { joints: places, up, front, ...(source && { source }) });
    return this.transport.message(MakeRigResponseSchema, "POST", this.path("/rig"), { ...call, json });
  }

  /** The model in its current shape with all of its files, by name: "" is the main one, others lie beside it (`gltf`). */
  async files(format?: Format, call: CallOptions = {}): Promise<Map<string, Blob>> {
    const path = this.path(format === undefined ? "/model" : `/model?format=${format}`);
    const read = async (response: Response) => ({ link: response.headers.get("link") ?? "", main: await response.blob() });
    const { link, main } = await this.transport.read("GET", path, "*/*", call, read);
    const files = new Map([["", main]]);
    for (const [, target] of link.matchAll(/<([^>]*)>; rel="item"/g)) {
      if (target === undefined) continue;
      const name = new URL(target, this.transport.url).searchParams.get("uri") ?? "";
      files.set(name, await this.transport.read("GET", target, "*/*", call, blobOf));
    }
    return files;
  }

  /**
   * Opens the stream on which handles are dragged. A connection that is lost is opened again for `patience` seconds (60 unless said
   * otherwise); then the stream is `closed`.
   */
  stream(options: SolveOptions = {}, events: StreamEvents = {}, { patience = 60 }: { patience?: number } = {}): Stream {
    const path = this.path("/stream");
    const route = {
      connect: () => this.transport.socket(path),
      probe: () => this.told(this.transport.probe(SessionSchema, this.path(""))),
      known: () => this.known,
      // Edits change it, and those of others are told by the revision alone.
      vertices: (revision: number) => {
        const { primitives, revision: told } = this.facts;
        return revision === Number(told) ? primitives.reduce((sum, { vertexCount }) => sum + vertexCount, 0) : undefined;
      },
    };
    return new Stream(route, options, events, patience);
  }

  /** Closes the session and frees what it held. */
  close(call: CallOptions = {}): Promise<void> {
    return this.transport.remove(this.path(""), call);
  }

  private path(rest: string): string {
    return `/v1/sessions/${encodeURIComponent(this.id)}${rest}`;
  }

  private async told(answer: Promise<Facts>): Promise<Facts> {
    this.facts = await answer;
    this.known = Math.max(this.known, Number(this.facts.revision));
    return this.facts;
  }
}

/** A handle as the schema has it. */
function handleFrom({ region, ...rest }: Handle): Named<MessageInitShape<typeof HandleSchema>> {
  return { ...rest, ...(region && { region: regionFrom(region) }) };
}

const blobOf = (response: Response): Promise<Blob> => response.blob();

export type { EditResult, Facts, HistoryResponse, Quality };
