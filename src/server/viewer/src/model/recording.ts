/** What the page itself reads of a BVH file: how many frames it says to have, and how long each lasts. The server reads the rest. */

/** Bytes that are searched; joints come first, and there are few of them. */
const HEAD_BYTES = 4 << 20;

export interface RecordingFacts {
  /** Seconds from one frame to the next, where the file says something sensible. */
  readonly frameTime: number | undefined;
}

export async function recordingFacts(file: Blob): Promise<RecordingFacts> {
  const head = await file.slice(0, HEAD_BYTES).text();
  const told = Number(/Frame Time:\s*(\S+)/i.exec(head)?.[1]);
  return { frameTime: Number.isFinite(told) && told > 0 ? told : undefined };
}
