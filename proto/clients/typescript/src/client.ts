/** The way in: opens sessions, finds open ones, asks for limits. */

import type { MessageInitShape } from "@bufbuild/protobuf";
import type { Limits, Session as Facts } from "./gen/pliant/v1/pliant_pb.js";
import {
  CreateOptionsSchema,
  LimitsSchema,
  ListSessionsResponseSchema,
  SessionSchema,
} from "./gen/pliant/v1/pliant_pb.js";
import { PliantError } from "./errors.js";
import type { Named } from "./names.js";
import { written } from "./poses.js";
import { Session } from "./session.js";
import type { CallOptions, Progress, TransportOptions } from "./transport.js";
import { Transport, jsonOf } from "./transport.js";

/** How a session is built from its model. */
export type CreateOptions = Named<MessageInitShape<typeof CreateOptionsSchema>>;

/** How a model is opened. */
export interface OpenOptions extends CallOptions {
  /** How the session is built. */
  create?: CreateOptions;
  /** Files that the model refers to, by the name it gives them (buffers and images of a `.gltf`, libraries of an `.obj`); `companionsOf` finds them. */
  companions?: ReadonlyMap<string, Blob>;
  /** Called with the uploaded fraction. */
  onProgress?: Progress;
}

/** Talks to one pliant server. */
export class Client {
  /** For calls that this class has no method for. */
  readonly transport: Transport;

  constructor(options: TransportOptions = {}) {
    this.transport = new Transport(options);
  }

  toString(): string {
    return `Client of ${this.transport.url}`;
  }

  /** What node's console shows. */
  [Symbol.for("nodejs.util.inspect.custom")](): string {
    return this.toString();
  }

  /** Uploads a model (glb, vrm, gltf, obj, ply, off, stl, 3mf, fbx, splat or spz) and opens a session with it. */
  async open(model: Blob, options: OpenOptions = {}): Promise<Session> {
    checkModel(model);
    const { create: given = {}, companions, ...call } = options;
    // A session is known by its file, unless it is given another name.
    const create = given.label === undefined && model instanceof File ? { ...given, label: labelOf(model) } : given;
    if (companions !== undefined && companions.size > 0) {
      const form = new FormData();
      form.set("options", new Blob([JSON.stringify(jsonOf(CreateOptionsSchema, create))], { type: "application/json" }));
      form.set("model", model, model instanceof File ? model.name : "model");
      for (const [uri, file] of companions) {
        form.append("companion", file, uri);
      }
      return new Session(this.transport, await this.transport.upload(SessionSchema, "/v1/sessions", form, undefined, call));
    }
    const path = `/v1/sessions?options=${query(create)}`;
    const facts = await this.transport.upload(SessionSchema, path, model, "application/octet-stream", call);
    return new Session(this.transport, facts);
  }

  /** Opens a session with a built-in model: the creature, or the figure, which has a skeleton, clips, levels of detail and sockets. */
  async sample(
    options: Omit<OpenOptions, "companions" | "onProgress"> & { name?: "creature" | "figure" } = {},
  ): Promise<Session> {
    const { create = {}, name = "creature", ...call } = options;
    const path = `/v1/sessions?sample=${name}&options=${query(create)}`;
    return new Session(this.transport, await this.transport.message(SessionSchema, "POST", path, call));
  }

  /** Takes up an open session, such as after a reload of the page. Fails with `NOT_FOUND` when it is no more. */
  async session(id: string, call: CallOptions = {}): Promise<Session> {
    const path = `/v1/sessions/${encodeURIComponent(id)}`;
    return new Session(this.transport, await this.transport.message(SessionSchema, "GET", path, call));
  }

  /** All open sessions of the caller, oldest first. */
  async sessions(call: CallOptions = {}): Promise<Facts[]> {
    const found: Facts[] = [];
    let token = "";
    do {
      const path = `/v1/sessions?pageSize=100&pageToken=${encodeURIComponent(token)}`;
      const page = await this.transport.message(ListSessionsResponseSchema, "GET", path, call);
      found.push(...page.sessions);
      token = page.nextPageToken;
    } while (token !== "");
    return found;
  }

  /** The limits that the server enforces. */
  limits(call: CallOptions = {}): Promise<Limits> {
    return this.transport.message(LimitsSchema, "GET", "/v1/limits", call);
  }
}

function query(create: CreateOptions): string {
  return encodeURIComponent(JSON.stringify(jsonOf(CreateOptionsSchema, create)));
}

/** Bytes of the longest label that a server takes. */
const LONGEST_LABEL = 256;

/** Refuses a path, whose letters the server would read as a model. */
function checkModel(model: unknown): void {
  if (typeof model !== "string") return;
  const how = "a File or a Blob is allowed; in node, new Blob([await readFile(path)])";
  throw new PliantError("INVALID_ARGUMENT", `model: ${written(model)} is a string; ${how}`);
}

/** A file's name as a label; none where it makes none. */
function labelOf({ name }: File): string {
  const plain = !/\p{C}/u.test(name) && new TextEncoder().encode(name).length <= LONGEST_LABEL;
  return plain ? name : "";
}
