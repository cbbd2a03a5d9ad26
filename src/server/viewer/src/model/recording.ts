/** What the page itself reads of a BVH file: how many frames it says to have, and how long each lasts. The server reads the rest. */

/** Bytes that are searched; joints come first, and there are few of them. */
const HEAD_BYTES = 4 << 20;

export interface RecordingFacts {
  /** Seconds from one frame to the next, where the file says something sensible. */
  readonly frameTime: number | undefined;
}

/** The frames that a rig depends on. */
const RIG_FRAMES = 3;

/** A recording without what a rig does not depend on: its joints and first frames, or all of it where these cannot be read. */
export async function firstFrames(clip: Blob): Promise<Uint8Array<ArrayBuffer>> {
  const head = await clip.slice(0, HEAD_BYTES).text();
  const motion = /^([\s\S]*?\bFrames:\s*)(\d+)(\s+Frame Time:[^\n]*\n)([\s\S]*)$/i.exec(head);
  const [, joints = "", frames = "", time = "", rows = ""] = motion ?? [];
  const lines = rows.split("\n").filter((line) => line.trim() !== "");
  // The last line may be cut off.
  const whole = clip.size > HEAD_BYTES ? lines.slice(0, -1) : lines;
  if (motion === null || Number(frames) <= RIG_FRAMES || whole.length < RIG_FRAMES) return new Uint8Array(await clip.arrayBuffer());
  return new TextEncoder().encode(`${joints}${RIG_FRAMES}${time}${whole.slice(0, RIG_FRAMES).join("\n")}\n`);
}

export async function recordingFacts(file: Blob): Promise<RecordingFacts> {
  const head = await file.slice(0, HEAD_BYTES).text();
  const told = Number(/Frame Time:\s*(\S+)/i.exec(head)?.[1]);
  return { frameTime: Number.isFinite(told) && told > 0 ? told : undefined };
}
