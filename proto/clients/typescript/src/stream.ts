/**
 * The Deform stream over a WebSocket: poses out, frames in.
 *
 * The newest pose wins on both sides: what the socket has not taken yet is replaced here, what the server has not begun
 * is replaced there. A frame counts as read when `take` has written it into the caller's buffer, so a page that paints
 * slowly gets fewer frames, never older ones. A lost socket is opened again, with the session as it was: options, the
 * newest pose and an unanswered commit go out anew. Only when the server no longer knows the session does the stream
 * end, in the state `gone`.
 */

import { create, fromBinary, toBinary } from "@bufbuild/protobuf";
import { PliantError, statusName } from "./errors.js";
import type { FrameFacts } from "./frames.js";
import { Assembler, Frame } from "./frames.js";
import type { DeformResponse, Session as Facts } from "./gen/pliant/v1/pliant_pb.js";
import { DeformRequestSchema, DeformResponseSchema } from "./gen/pliant/v1/pliant_pb.js";
import type { PoseEntry, SolveOptions } from "./session.js";

/**
 * `connecting` the first time, `open`, `lost` while it is being opened again, `gone` when the session is no more (the
 * server restarted, or it expired), `closed` by `close()` or by a defect.
 */
export type StreamState = "connecting" | "open" | "lost" | "gone" | "closed";

/** What a stream tells. */
export interface StreamEvents {
  /** The state changed; `reason` is the last failure. */
  onState?: (state: StreamState, reason?: PliantError) => void;
  /** A whole frame is here; call `take` when there is time to show it. */
  onFrame?: (frame: FrameFacts) => void;
  /** A pose was refused. */
  onPoseError?: (error: PliantError, seq: number) => void;
  /** Something worth telling a user, such as `going-away`. */
  onNotice?: (code: string, message: string) => void;
}

/** Sums since the stream was made. */
export interface StreamTotals {
  poses: number;
  frames: number;
  superseded: number;
  bytes: number;
  reconnects: number;
}

/** How a stream reaches its session. */
export interface StreamRoute {
  connect: () => WebSocket;
  /** Asks whether the session is there, without the socket. */
  probe: () => Promise<Facts>;
  /** The newest revision that calls beside the stream were told of. */
  known: () => number;
}

interface Commit {
  seq: number;
  entries: PoseEntry[];
  /** The newest revision known when it was sent. */
  since: number;
  resolve: (frame: FrameFacts) => void;
  reject: (error: PliantError) => void;
}

/** Pauses between attempts, in milliseconds; the last one repeats. */
const PAUSES = [100, 250, 500, 1000, 2000, 4000];
/** Silence after which a sign of life is asked for, and how long it may take. */
const SILENCE_MS = 15_000;
const PATIENCE_MS = 10_000;
/** Bytes in the socket above which poses wait here, where they can still be replaced. */
const BACKLOG = 64 << 10;

/** A stream on a session. Made by `Session.stream`. */
export class Stream {
  readonly totals: StreamTotals = { poses: 0, frames: 0, superseded: 0, bytes: 0, reconnects: 0 };
  private socket: WebSocket | undefined;
  private assembler = new Assembler();
  private current: StreamState = "connecting";
  private seq = 0;
  private revision = 0;
  /** The newest drag pose that no final frame has answered yet. */
  private newest: { seq: number; entries: PoseEntry[]; sent: boolean } | undefined;
  private readonly commits: Commit[] = [];
  /** Commits known to be stored, by the number of the pose that shows them. */
  private readonly stored = new Map<number, Commit>();
  private frames: Frame[] = [];
  private attempt = 0;
  private heardAt = 0;
  private askedAt = 0;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private readonly pulse: ReturnType<typeof setInterval>;

  constructor(
    private readonly route: StreamRoute,
    private options: SolveOptions,
    private readonly events: StreamEvents,
  ) {
    this.pulse = setInterval(() => this.beat(), 5_000);
    this.open();
  }

  get state(): StreamState {
    return this.current;
  }

  /** Sends a pose to show, or to replace the one that waits. Answers its number. */
  pose(entries: PoseEntry[]): number {
    this.newest = { seq: ++this.seq, entries, sent: false };
    this.totals.poses += 1;
    this.flush();
    return this.seq;
  }

  /** Sends a pose to record. Answers its last frame, once it is stored; it survives a lost socket. */
  commit(entries: PoseEntry[]): Promise<FrameFacts> {
    return new Promise((resolve, reject) => {
      if (this.isOver) {
        reject(new PliantError("CANCELLED", "the stream is closed"));
        return;
      }
      // What was dragged before is part of the commit, or has no meaning after it.
      this.newest = undefined;
      const commit: Commit = { seq: ++this.seq, entries, since: this.knownRevision, resolve, reject };
      this.commits.push(commit);
      this.totals.poses += 1;
      this.sendPose(commit.seq, entries, true);
    });
  }

  /** Replaces the options of the poses that follow. */
  setOptions(options: SolveOptions): void {
    this.options = options;
    this.send({ case: "options", value: options });
  }

  /** Whether a frame waits to be taken. */
  get hasFrame(): boolean {
    return this.frames.length > 0;
  }

  /**
   * Writes the newest shape into `positions` (and `normals`, when frames carry them) and tells the server that it was
   * read. Answers what was written last, or nothing when there was nothing new.
   */
  take(positions: Float32Array, normals?: Float32Array): Frame | undefined {
    const waiting = this.frames;
    const last = waiting.at(-1);
    if (last === undefined) {
      return undefined;
    }
    this.frames = [];
    // Everything before the last whole frame is overwritten by it.
    const from = Math.max(0, waiting.findLastIndex((frame) => !frame.isPartial));
    for (const frame of waiting.slice(from)) {
      frame.positionsInto(positions);
      if (normals !== undefined && frame.hasNormals) {
        frame.normalsInto(normals);
      }
    }
    this.send({ case: "ack", value: { seq: BigInt(last.seq) } });
    return last;
  }

  /** Forgets frames that were not taken, when the buffer they belong to is no more. */
  drop(): void {
    const last = this.frames.at(-1);
    this.frames = [];
    if (last !== undefined) {
      this.send({ case: "ack", value: { seq: BigInt(last.seq) } });
    }
  }

  /** Tries at once instead of after the pause, such as when the network is back. */
  retry(): void {
    if (this.current === "lost") {
      clearTimeout(this.timer);
      this.attempt = 0;
      void this.reopen();
    }
  }

  /** Ends the stream; the session stays. */
  close(): void {
    this.end("closed");
  }

  private get isOver(): boolean {
    return this.current === "closed" || this.current === "gone";
  }

  private open(): void {
    const socket = this.route.connect();
    this.socket = socket;
    this.assembler = new Assembler();
    this.heardAt = Date.now();
    this.askedAt = 0;
    let reason: PliantError | undefined;
    socket.onopen = () => {
      this.attempt = 0;
      this.change("open");
      this.send({ case: "options", value: this.options });
      for (const { seq, entries } of this.commits) {
        this.sendPose(seq, entries, true);
      }
      if (this.newest !== undefined) {
        this.newest.sent = false;
        this.flush();
      }
    };
    socket.onmessage = (event: MessageEvent<ArrayBuffer>) => {
      this.heardAt = Date.now();
      this.askedAt = 0;
      try {
        const failure = this.receive(fromBinary(DeformResponseSchema, new Uint8Array(event.data)));
        reason = failure ?? reason;
      } catch (error) {
        reason = new PliantError("DATA_LOSS", error instanceof Error ? error.message : String(error));
        socket.close();
      }
    };
    socket.onclose = (event) => {
      if (socket !== this.socket || this.isOver) {
        return;
      }
      this.socket = undefined;
      const told = event.reason === "" ? "the connection was lost" : event.reason;
      const code = event.code > 4000 ? statusName(event.code - 4000) : "UNREACHABLE";
      this.lose(reason ?? new PliantError(code, told));
    };
  }

  private lose(reason: PliantError): void {
    // What was half read is read anew: the first frame of a new socket is whole.
    this.frames = [];
    if (reason.isGone) {
      this.end("gone", reason);
      return;
    }
    this.change("lost", reason);
    const pause = PAUSES[Math.min(this.attempt, PAUSES.length - 1)] as number;
    this.attempt += 1;
    this.timer = setTimeout(() => void this.reopen(), pause);
  }

  /** A refused upgrade says nothing to a page, so the session is asked for first. */
  private async reopen(): Promise<void> {
    try {
      const facts = await this.route.probe();
      if (this.isOver) {
        return;
      }
      this.adopt(Number(facts.revision));
      this.totals.reconnects += 1;
      this.open();
    } catch (error) {
      if (!this.isOver) {
        this.lose(error instanceof PliantError ? error : new PliantError("UNKNOWN", String(error)));
      }
    }
  }

  /**
   * A commit whose answer was lost may be stored all the same; then its pose is asked for without another commit. Where
   * the revision tells of more than these commits, others were at work: a commit made twice does less harm than none.
   */
  private adopt(revision: number): void {
    const made = revision - (this.commits[0]?.since ?? revision);
    if (made > 0 && made <= this.commits.length) {
      for (const commit of this.commits.splice(0, made)) {
        this.newest = { seq: ++this.seq, entries: commit.entries, sent: false };
        this.stored.set(this.seq, commit);
      }
    }
    this.revision = Math.max(this.revision, revision);
  }

  private get knownRevision(): number {
    return Math.max(this.revision, this.route.known());
  }

  private receive(response: DeformResponse): PliantError | undefined {
    const { message } = response;
    if (message.case === "frame") {
      const frame = this.assembler.push(message.value);
      if (frame !== undefined) {
        this.arrived(frame);
      }
    } else if (message.case === "error") {
      const error = new PliantError(statusName(message.value.code), message.value.message);
      const seq = Number(message.value.seq);
      if (seq === 0) {
        return error;
      }
      this.refused(error, seq);
    } else if (message.case === "notice") {
      this.events.onNotice?.(message.value.code, message.value.message);
    }
    return undefined;
  }

  private arrived(frame: Frame): void {
    this.totals.frames += 1;
    this.totals.superseded += frame.superseded;
    this.totals.bytes += frame.bytes;
    this.revision = Math.max(this.revision, frame.revision);
    this.frames.push(frame);
    this.events.onFrame?.(frame);
    if (frame.final) {
      if (this.newest !== undefined && frame.seq >= this.newest.seq) {
        this.newest = undefined;
      }
      for (const commit of this.answered(frame.seq)) {
        commit.resolve(frame);
      }
    }
  }

  private refused(error: PliantError, seq: number): void {
    if (this.newest?.seq === seq) {
      this.newest = undefined;
    }
    for (const commit of this.answered(seq)) {
      commit.reject(error);
    }
    this.events.onPoseError?.(error, seq);
  }

  /** Commits that a frame or an error with this number answers. */
  private answered(seq: number): Commit[] {
    const done = this.commits.filter((commit) => commit.seq === seq);
    for (const commit of done) {
      this.commits.splice(this.commits.indexOf(commit), 1);
    }
    for (const [shown, commit] of [...this.stored]) {
      if (shown <= seq) {
        this.stored.delete(shown);
        done.push(commit);
      }
    }
    return done;
  }

  /** Sends the newest pose when the socket has room. */
  private flush(): void {
    const { newest, socket } = this;
    if (newest === undefined || newest.sent || socket === undefined || socket.readyState !== socket.OPEN) {
      return;
    }
    if (socket.bufferedAmount > BACKLOG) {
      setTimeout(() => this.flush(), 8);
      return;
    }
    newest.sent = true;
    this.sendPose(newest.seq, newest.entries, false);
  }

  private sendPose(seq: number, handles: PoseEntry[], commit: boolean): void {
    this.send({ case: "pose", value: { seq: BigInt(seq), handles, commit } });
  }

  private send(message: NonNullable<Parameters<typeof create<typeof DeformRequestSchema>>[1]>["message"] & {}): void {
    const { socket } = this;
    if (socket !== undefined && socket.readyState === socket.OPEN) {
      socket.send(toBinary(DeformRequestSchema, create(DeformRequestSchema, { message })));
    }
  }

  /** Notices a connection that died without a word. */
  private beat(): void {
    const { socket } = this;
    if (socket === undefined || this.current !== "open") {
      return;
    }
    const now = Date.now();
    if (this.askedAt > 0 && now - this.askedAt > PATIENCE_MS) {
      socket.close();
      // The closing handshake of a dead connection takes long.
      this.socket = undefined;
      this.lose(new PliantError("UNREACHABLE", "the connection gives no sign of life"));
    } else if (this.askedAt === 0 && now - this.heardAt > SILENCE_MS) {
      this.askedAt = now;
      this.send({ case: "ping", value: { nonce: BigInt(now) } });
    }
  }

  private end(state: "gone" | "closed", reason?: PliantError): void {
    if (this.isOver) {
      return;
    }
    clearInterval(this.pulse);
    clearTimeout(this.timer);
    const { socket } = this;
    this.socket = undefined;
    socket?.close();
    const why = reason ?? new PliantError("CANCELLED", "the stream was closed");
    this.change(state, reason);
    for (const commit of [...this.commits, ...this.stored.values()]) {
      commit.reject(why);
    }
    this.commits.length = 0;
    this.stored.clear();
  }

  private change(state: StreamState, reason?: PliantError): void {
    this.current = state;
    this.events.onState?.(state, reason);
  }
}
