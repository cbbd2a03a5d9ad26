/**
 * The Deform stream over a WebSocket: poses out, frames in.
 *
 * The newest pose wins on both sides: what the socket has not taken yet is replaced here, what the server has not begun
 * is replaced there. A frame counts as read when `take` has written it into the caller's buffer, so a page that paints
 * slowly gets fewer frames, never older ones.
 *
 * The stream reopens a socket that is lost, or whose server stops or cannot record a commit now. It sends options,
 * commits without an answer and the newest pose again. A commit carries a key, so that one which was stored before its
 * answer was lost is answered and not made twice, also by a server that was started again. The stream ends when the
 * server no longer knows the session (`gone`), or is not found again in time (`closed`).
 */

import { create, fromBinary, toBinary } from "@bufbuild/protobuf";
import { SIGN_OF_LIFE_MS, SILENCE_MS } from "./alive.js";
import { Attempts } from "./attempts.js";
import { PliantError, statusName } from "./errors.js";
import type { FrameFacts } from "./frames.js";
import { Assembler, Frame } from "./frames.js";
import type { DeformResponse, Session as Facts } from "./gen/pliant/v1/pliant_pb.js";
import { DeformRequestSchema, DeformResponseSchema, OptionsSchema } from "./gen/pliant/v1/pliant_pb.js";
import { numbered } from "./names.js";
import { type Options, Pending } from "./pending.js";
import { checkPoses } from "./poses.js";
import type { PoseEntry, SolveOptions } from "./session.js";

/**
 * `connecting` the first time, `open`, `lost` while it is being opened again, `gone` when the session is no more (it expired, or a
 * server without `data_dir` restarted), `closed` by `close()` or because the server was not found again in time.
 */
export type StreamState = "connecting" | "open" | "lost" | "gone" | "closed";

/** Events of a stream. */
export interface StreamEvents {
  /** The state changed; `reason` is the last failure. */
  onState?: (state: StreamState, reason?: PliantError) => void;
  /** A whole frame is here; call `take` when there is time to show it. */
  onFrame?: (frame: FrameFacts) => void;
  /** A pose was refused. */
  onPoseError?: (error: PliantError, seq: number) => void;
  /** Something to show to a user, such as `going-away`. */
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
  /** Reads the session, without the socket, and fails where no server answers. */
  probe: () => Promise<Facts>;
  /** The newest revision that calls beside the stream returned. */
  known: () => number;
  /** How many vertices the model has at a revision, where that is known. */
  vertices?: (revision: number) => number | undefined;
}

/** Between checks of the silence. */
const BEAT_MS = 1_000;
/** Bytes in the socket above which poses wait here, where they can still be replaced. */
const BACKLOG = 64 << 10;

/** A stream on a session. Made by `Session.stream`. */
export class Stream {
  readonly totals: StreamTotals = { poses: 0, frames: 0, superseded: 0, bytes: 0, reconnects: 0 };
  private socket: WebSocket | undefined;
  private assembler: Assembler;
  private current: StreamState = "connecting";
  private options: Options;
  private revision: number;
  private readonly pending: Pending;
  /** Whole frames that wait to be taken; those of a lost socket are shown, but not acknowledged. */
  private frames: Frame[] = [];
  private fresh = new WeakSet<Frame>();
  /** The options that the socket got last. */
  private told: Options | undefined;
  private readonly attempts: Attempts;
  /** Whether the server on the other end has said that it stops. */
  private leaving: PliantError | undefined;
  /** Sockets in a row that brought what cannot be read. */
  private unreadable = 0;
  private heardAt = 0;
  private askedAt = 0;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private readonly pulse: ReturnType<typeof setInterval>;

  constructor(
    private readonly route: StreamRoute,
    options: SolveOptions,
    private readonly events: StreamEvents,
    patience: number,
  ) {
    this.options = numbered(OptionsSchema, options);
    this.attempts = new Attempts(patience);
    this.pending = new Pending(patience);
    this.revision = route.known();
    this.assembler = new Assembler(route.vertices);
    this.open();
    // After what may throw: an interval that nobody can clear would keep the process from its end.
    this.pulse = setInterval(() => this.beat(), BEAT_MS);
  }

  get state(): StreamState {
    return this.current;
  }

  /** Sends a pose to show, or to replace the one that waits. Answers its number. */
  pose(entries: PoseEntry[]): number {
    checkPoses(entries);
    this.lookBeside();
    const seq = this.pending.drag(entries);
    this.totals.poses += 1;
    this.flush();
    return seq;
  }

  /**
   * Sends a pose to record, with what was dragged since the last one. Answers its last frame, once it is stored; it survives a lost
   * socket and a server that is started again, and is recorded once.
   */
  commit(entries: PoseEntry[]): Promise<FrameFacts> {
    return new Promise((resolve, reject) => {
      if (this.isOver) {
        reject(new PliantError("CANCELLED", "the stream is closed"));
        return;
      }
      checkPoses(entries);
      this.lookBeside();
      this.pending.commit(entries, this.options, { resolve, reject });
      this.totals.poses += 1;
      this.flush();
    });
  }

  /** Replaces the options of the poses that follow. */
  setOptions(options: SolveOptions): void {
    this.options = numbered(OptionsSchema, options);
    if (this.isHeard) this.sayOptions(this.options);
  }

  /** Whether a frame waits to be taken. */
  get hasFrame(): boolean {
    return this.frames.length > 0;
  }

  /**
   * Writes the newest shape into `positions` (and `normals`, when frames carry them) and acknowledges it to the server.
   * Answers what was written last, or nothing when there was nothing new.
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
    try {
      for (const frame of waiting.slice(from)) {
        frame.positionsInto(positions);
        if (normals !== undefined && frame.hasNormals) {
          frame.normalsInto(normals);
        }
      }
    } finally {
      // A frame that does not fit the buffer is gone as well: the server must not wait for it.
      this.acknowledge(last);
    }
    return last;
  }

  /** Forgets frames that were not taken, when the buffer they belong to is no more. */
  drop(): void {
    const last = this.frames.at(-1);
    this.frames = [];
    if (last !== undefined) {
      this.acknowledge(last);
    }
  }

  private acknowledge(frame: Frame): void {
    if (this.fresh.has(frame)) this.send({ case: "ack", value: { seq: BigInt(frame.seq) } });
  }

  /** Tries at once instead of after the pause, such as when the network is back. */
  retry(): void {
    if (this.current === "lost") {
      clearTimeout(this.timer);
      this.attempts.hurry();
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
    // What was half read is read anew: the first frame of a new socket is whole.
    this.assembler = new Assembler(this.route.vertices);
    this.fresh = new WeakSet();
    this.heardAt = Date.now();
    this.askedAt = 0;
    this.leaving = undefined;
    let reason: PliantError | undefined;
    let [messages, frames] = [0, 0];
    socket.onopen = () => {
      this.change("open");
      this.told = undefined;
      this.sayOptions(this.options);
      this.pending.opened();
      this.flush();
    };
    socket.onmessage = (event: MessageEvent<ArrayBuffer>) => {
      // What a socket that was left still says, the next one is asked again.
      if (socket !== this.socket) return;
      this.heardAt = Date.now();
      this.askedAt = 0;
      if (reason?.code === "DATA_LOSS") return;
      let message: DeformResponse["message"];
      let frame: Frame | undefined;
      try {
        ({ message } = fromBinary(DeformResponseSchema, new Uint8Array(event.data)));
        if (message.case === "frame") frame = this.assembler.push(message.value);
      } catch (error) {
        reason = new PliantError("DATA_LOSS", error instanceof Error ? error.message : String(error));
        this.unreadable += 1;
        // What another socket brings as well will not be read by a third.
        if (this.unreadable > 1) this.end("closed", reason);
        else socket.close();
        return;
      }
      // The first frame of a socket is told as a whole, so the second must be read as well.
      if (frame !== undefined && ++frames > 1) this.unreadable = 0;
      const failure = this.receive(message, frame);
      reason = failure ?? reason;
      // Only what was said and understood shows that it works, not a socket that opened.
      if (failure === undefined && messages++ === 0) this.attempts.worked();
      this.leave();
    };
    socket.onclose = (event) => {
      if (socket !== this.socket || this.isOver) {
        return;
      }
      this.socket = undefined;
      const told = event.reason === "" ? "the connection was lost" : event.reason;
      const code = event.code > 4000 ? statusName(event.code - 4000) : "UNREACHABLE";
      this.lose(reason ?? this.leaving ?? new PliantError(code, told));
    };
    socket.onerror = () => {
      // Not every platform closes a socket that was never open, such as one that was sent elsewhere.
      if (socket !== this.socket || this.isOver || this.current === "open") return;
      this.socket = undefined;
      this.lose(new PliantError("UNREACHABLE", "the connection was refused"));
    };
  }

  /** Leaves a server that stops, once what it was given to record is answered. */
  private leave(): void {
    const { socket, leaving } = this;
    if (leaving === undefined || socket === undefined || this.pending.isOwed) return;
    this.socket = undefined;
    socket.close();
    this.lose(leaving);
  }

  private lose(reason: PliantError): void {
    if (reason.isGone) {
      this.end("gone", reason);
      return;
    }
    const pause = this.attempts.again(reason);
    if (pause === undefined) {
      this.end("closed", this.attempts.lastWord(reason));
      return;
    }
    this.change("lost", reason);
    this.timer = setTimeout(() => void this.reopen(), pause);
  }

  /** A refused upgrade says nothing to a page, so the session is asked for first. */
  private async reopen(): Promise<void> {
    try {
      const facts = await this.route.probe();
      if (this.isOver) {
        return;
      }
      // It may be newer by a commit of this stream whose answer was lost.
      this.revision = Math.max(this.revision, Number(facts.revision));
      this.totals.reconnects += 1;
      this.open();
    } catch (error) {
      if (!this.isOver) {
        this.lose(error instanceof PliantError ? error : new PliantError("UNKNOWN", String(error)));
      }
    }
  }

  /** Calls beside the stream have changed the session: what was dragged before them is void on the server, so it is here. */
  private lookBeside(): void {
    const known = this.route.known();
    if (known > this.revision) {
      this.revision = known;
      this.pending.forget();
    }
  }

  private receive(message: DeformResponse["message"], frame: Frame | undefined): PliantError | undefined {
    if (frame !== undefined) {
      this.arrived(frame);
    } else if (message.case === "error") {
      const error = new PliantError(statusName(message.value.code), message.value.message);
      const seq = Number(message.value.seq);
      if (seq === 0) {
        return error;
      }
      this.refused(error, seq);
    } else if (message.case === "notice") {
      if (message.value.code === "going-away") this.leaving = new PliantError("UNAVAILABLE", message.value.message);
      this.events.onNotice?.(message.value.code, message.value.message);
    }
    return undefined;
  }

  private arrived(frame: Frame): void {
    this.totals.frames += 1;
    this.totals.superseded += frame.superseded;
    this.totals.bytes += frame.bytes;
    if (frame.revision > this.revision) {
      this.revision = frame.revision;
      // Somebody else's commit.
      if (!this.pending.isCommit(frame.seq)) this.pending.forget();
    }
    this.fresh.add(frame);
    this.frames.push(frame);
    this.events.onFrame?.(frame);
    if (frame.final) {
      this.pending.answered(frame.seq)?.resolve(frame);
      this.flush();
    }
  }

  private refused(refusal: PliantError, seq: number): void {
    let error = refusal;
    if (error.code === "UNAVAILABLE") {
      if (this.leaving !== undefined) {
        // The server came to its end before it came to this pose; the next one gets it.
        this.pending.putBack(seq);
        return;
      }
      // Its session is at another node by now, or what it keeps sessions in is away.
      const wait = this.pending.hold(seq, error);
      if (wait !== undefined) {
        const { socket } = this;
        setTimeout(() => this.renew(socket, refusal), wait);
        this.flush();
        return;
      }
      error = this.pending.lastWord(seq, error);
    }
    this.pending.answered(seq, true)?.reject(error);
    this.flush();
    this.events.onPoseError?.(error, seq);
  }

  /**
   * Leaves a server that could not record a commit, and finds the session again by another socket: numbers grow along
   * one.
   */
  private renew(socket: WebSocket | undefined, reason: PliantError): void {
    if (socket === undefined || socket !== this.socket || this.isOver || this.leaving !== undefined) return;
    this.socket = undefined;
    socket.close();
    this.change("lost", reason);
    void this.reopen();
  }

  /** Sends commits that wait, and the newest pose when the socket has room. */
  private flush(): void {
    const { socket } = this;
    if (socket === undefined || !this.isHeard) return;
    for (let next = this.pending.nextCommit(); next !== undefined; next = this.pending.nextCommit()) {
      this.sayOptions(next.options);
      this.send({ case: "pose", value: next.pose });
    }
    this.sayOptions(this.options);
    if (!this.pending.hasDrag) return;
    if (socket.bufferedAmount > BACKLOG) {
      setTimeout(() => this.flush(), 8);
      return;
    }
    const value = this.pending.nextDrag();
    if (value !== undefined) this.send({ case: "pose", value });
  }

  /** Sends the options of the poses that follow, unless the server has them. */
  private sayOptions(options: Options): void {
    if (options === this.told) return;
    this.told = options;
    this.send({ case: "options", value: options });
  }

  /** Whether there is a server on the other end that stays. */
  private get isHeard(): boolean {
    const { socket, leaving } = this;
    return leaving === undefined && socket !== undefined && socket.readyState === socket.OPEN;
  }

  private send(message: NonNullable<Parameters<typeof create<typeof DeformRequestSchema>>[1]>["message"] & {}): void {
    const { socket } = this;
    if (socket !== undefined && socket.readyState === socket.OPEN) {
      socket.send(toBinary(DeformRequestSchema, create(DeformRequestSchema, { message })));
    }
  }

  /** Notices a connection that died without a word, a server that stands still, and a socket that neither opens nor fails. */
  private beat(): void {
    const { socket } = this;
    if (socket === undefined) {
      return;
    }
    const now = Date.now();
    const owes = socket.readyState === socket.OPEN ? this.askedAt : this.heardAt;
    if (owes > 0 && now - owes > SIGN_OF_LIFE_MS) {
      // The closing handshake of a dead connection takes long, and one that never opened fails at once: neither is waited for.
      this.socket = undefined;
      socket.close();
      this.lose(new PliantError("UNREACHABLE", "the server does not answer on this connection"));
    } else if (socket.readyState !== socket.OPEN) {
      return;
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
    this.pending.giveUp(why);
  }

  private change(state: StreamState, reason?: PliantError): void {
    this.current = state;
    this.events.onState?.(state, reason);
  }
}
