/** What a stream has said and not been answered: the newest drag, commits, and where handles were dragged. */

import type { MessageInitShape } from "@bufbuild/protobuf";
import type { PliantError } from "./errors.js";
import type { FrameFacts } from "./frames.js";
import type { OptionsSchema, PoseSchema } from "./gen/pliant/v1/pliant_pb.js";
import type { PoseEntry } from "./session.js";
import { Attempts, newKey } from "./attempts.js";

type Pose = MessageInitShape<typeof PoseSchema>;
export type Options = MessageInitShape<typeof OptionsSchema>;

/** A pose that is to be recorded. */
interface Commit {
  readonly seq: number;
  readonly entries: PoseEntry[];
  /** Those in force when it was made. */
  readonly options: Options;
  /** By which the server knows one that is sent again. */
  readonly key: string;
  /** Whether it went out on the socket that is open. */
  sent: boolean;
  /** Whether the server could not record it, and it waits for the next socket. */
  held: boolean;
  readonly attempts: Attempts;
  readonly whose: Caller;
}

/** Who waits for a commit. */
interface Caller {
  readonly resolve: (frame: FrameFacts) => void;
  readonly reject: (error: PliantError) => void;
}

/** Commits on their way at the same time; a server takes 16 waiting ones. */
const COMMITS = 8;

/** The books of one stream, over all of its sockets. */
export class Pending {
  private seq = 0;
  /** The newest drag that no final frame has answered yet. */
  private newest: { seq: number; entries: PoseEntry[]; sent: boolean } | undefined;
  /** In the order in which they were made. */
  private readonly commits: Commit[] = [];
  /** Where handles were dragged since the last commit, and by which pose. */
  private readonly moved = new Map<string, { seq: number; entry: PoseEntry }>();
  /** Where the server last accepted them. */
  private readonly accepted = new Map<string, PoseEntry>();
  /** Whether the open socket has not received them yet. */
  private untold = false;

  /** `patience`: seconds for which a commit that cannot be recorded is tried again. */
  constructor(private readonly patience: number) {}

  /** A pose to show. Answers its number. */
  drag(entries: readonly PoseEntry[]): number {
    // One that never went out is part of the one that replaces it.
    const all = merged(this.newest?.sent === false ? this.newest.entries : [], entries);
    const seq = ++this.seq;
    for (const entry of all) this.moved.set(entry.id ?? "", { seq, entry });
    this.newest = { seq, entries: all, sent: false };
    return seq;
  }

  /** A pose to record, with all that was dragged before. */
  commit(entries: readonly PoseEntry[], options: Options, whose: Caller): void {
    const all = merged(this.dragged, entries);
    // What was dragged before is part of the commit, or has no meaning after it.
    this.forget();
    this.newest = undefined;
    this.commits.push({ seq: ++this.seq, entries: all, options, key: newKey(), sent: false, held: false, attempts: new Attempts(this.patience), whose });
  }

  /** What was dragged is void: others have changed the session. */
  forget(): void {
    this.moved.clear();
    this.accepted.clear();
  }

  private get dragged(): PoseEntry[] {
    return [...this.moved.values()].map(({ entry }) => entry);
  }

  /** A socket was opened; it has received nothing. */
  opened(): void {
    this.untold = true;
    for (const commit of this.commits) commit.sent = commit.held = false;
    if (this.newest !== undefined) this.newest.sent = false;
  }

  /** The next commit to send. */
  nextCommit(): { options: Options; pose: Pose } | undefined {
    const at = this.commits.findIndex(({ sent }) => !sent);
    const commit = this.commits[at];
    // Those behind one that is held wait with it: they are recorded in the order in which they were made.
    if (commit === undefined || at >= Math.min(COMMITS, this.firstHeld)) return undefined;
    commit.sent = true;
    const { seq, entries: handles, options, key: idempotencyKey } = commit;
    return { options, pose: { seq: BigInt(seq), handles, commit: true, idempotencyKey } };
  }

  /** Whether the newest drag is to be sent. Numbers grow along a stream, so commits before it go first. */
  get hasDrag(): boolean {
    return this.newest?.sent === false && this.commits.slice(0, this.firstHeld).every(({ sent }) => sent);
  }

  private get firstHeld(): number {
    const at = this.commits.findIndex(({ held }) => held);
    return at < 0 ? this.commits.length : at;
  }

  /** That drag. A new socket hears of all that was dragged. */
  nextDrag(): Pose | undefined {
    const { newest } = this;
    if (newest === undefined || !this.hasDrag) return undefined;
    if (this.untold) newest.entries = merged(this.dragged, newest.entries);
    this.untold = false;
    newest.sent = true;
    // What is held will be recorded before it: the shape that is shown meanwhile has it too.
    const held = this.commits.slice(this.firstHeld).reduce<PoseEntry[]>((all, { entries }) => merged(all, entries), []);
    return { seq: BigInt(newest.seq), handles: merged(held, newest.entries) };
  }

  /** Whether a commit was sent and not answered. */
  get isOwed(): boolean {
    return this.commits.some(({ sent }) => sent);
  }

  /** Whether this number is a commit's. */
  isCommit(seq: number): boolean {
    return this.commits.some((commit) => commit.seq === seq);
  }

  /** The pose was not looked at: it goes out again on the next socket. */
  putBack(seq: number): void {
    const commit = this.commits.find((each) => each.seq === seq);
    if (commit !== undefined) commit.sent = false;
  }

  /**
   * The server cannot record a commit now: it waits for the next socket, with those behind it. Milliseconds until that
   * is to be opened; undefined when it is not a commit, or was tried for long enough.
   */
  hold(seq: number, error: PliantError): number | undefined {
    const commit = this.commits.find((each) => each.seq === seq);
    const wait = commit?.attempts.again(error);
    if (commit === undefined || wait === undefined) return undefined;
    commit.sent = false;
    commit.held = true;
    return wait;
  }

  /** The failure of a commit that stands, with how long it was tried. */
  lastWord(seq: number, error: PliantError): PliantError {
    return this.commits.find((each) => each.seq === seq)?.attempts.lastWord(error) ?? error;
  }

  /** A final frame, or a refusal, answers a pose; if it is a commit's, who waits for it. */
  answered(seq: number, refused = false): Caller | undefined {
    const { newest } = this;
    for (const [id, { seq: by, entry }] of this.moved) {
      if (!refused && by <= seq) this.accepted.set(id, entry);
      if (!refused || by !== seq) continue;
      // What the server refused is not part of the next commit.
      const before = this.accepted.get(id);
      if (before === undefined) this.moved.delete(id);
      else this.moved.set(id, { seq: 0, entry: before });
    }
    if (newest !== undefined && (refused ? seq === newest.seq : seq >= newest.seq)) this.newest = undefined;
    const at = this.commits.findIndex((commit) => commit.seq === seq);
    return at < 0 ? undefined : this.commits.splice(at, 1)[0]?.whose;
  }

  /** Gives up all commits. */
  giveUp(why: PliantError): void {
    for (const { whose } of this.commits.splice(0)) whose.reject(why);
  }
}

/** Entries of the later pose in place of those of the earlier. */
function merged(earlier: readonly PoseEntry[], later: readonly PoseEntry[]): PoseEntry[] {
  const all = new Map(earlier.map((entry) => [entry.id, entry]));
  for (const entry of later) all.set(entry.id, entry);
  return [...all.values()];
}
