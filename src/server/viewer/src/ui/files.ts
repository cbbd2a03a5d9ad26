/** Files in and out of the page. */

import { type ClipSource, animate, rigOf } from "../app/animating.ts";
import { EXTENSIONS, openFiles } from "../app/opening.ts";
import { correctedRig } from "../app/rigging.ts";
import * as s from "../app/signals.ts";
import { allAnswered } from "../app/steps.ts";
import type { Format, PlacedFile } from "pliant-client";

/** Asks for a model with the browser's file picker. */
export function pickFiles(): void {
  // Companion files have any name, so the list of extensions is a hint that also lets buffers and images through.
  const accept = [...EXTENSIONS.map((extension) => `.${extension}`), ".bvh", ".bin", ".mtl", ".png", ".jpg", ".jpeg"];
  pick(accept, true, (files) => void take(files.map(placed)));
}

/** Asks for a recording, and a rig if it has one. */
export function pickRecording(): void {
  pick([".bvh", ".json"], true, (files) => void playRecording(files.map(placed)));
}

/** Asks for a model that an edit takes: its bytes, and the format that its name says. */
export function pickModel(take: (model: Uint8Array<ArrayBuffer>, format: string) => Promise<unknown>): void {
  pick(EXTENSIONS.map((extension) => `.${extension}`), false, ([file]) => {
    if (file === undefined) return;
    const format = file.name.split(".").at(-1)?.toLowerCase() ?? "";
    void file.arrayBuffer().then((bytes) => take(new Uint8Array(bytes), format), (error: unknown) => s.fail("The file cannot be read", error));
  });
}

/** Asks for files with the browser's file picker. */
function pick(accept: readonly string[], multiple: boolean, take: (files: readonly File[]) => void): void {
  const input = document.createElement("input");
  input.type = "file";
  input.multiple = multiple;
  input.accept = accept.join(",");
  input.onchange = () => take([...(input.files ?? [])]);
  input.click();
}

/** Opens models; a recording without one moves the model that is open. */
async function take(files: readonly PlacedFile[]): Promise<void> {
  const hasModel = files.some(({ path }) => EXTENSIONS.some((extension) => endsWith(path, extension)));
  if (!hasModel && files.some(({ path }) => endsWith(path, "bvh"))) await playRecording(files);
  else await openFiles(files);
}

/** Animates the model that is open by a BVH file, and the rig beside it. */
async function playRecording(files: readonly PlacedFile[]): Promise<void> {
  const clip = files.find(({ path }) => endsWith(path, "bvh"));
  const rig = files.find(({ path }) => endsWith(path, "json"));
  if (clip === undefined) {
    s.note("error", "Not a clip", "Drop a BVH file, and a rig (JSON) if the model is not an upright figure.");
    return;
  }
  try {
    const source: ClipSource = { title: clip.path.split("/").at(-1) ?? clip.path, bvh: clip.file };
    const given = rig === undefined ? await correctedRig(clip.file) : await rigOf(rig.file);
    await animate(given === undefined ? source : { ...source, rig: given });
  } catch (error) {
    s.fail("The clip cannot be played", error);
  }
}

function endsWith(path: string, extension: string): boolean {
  return path.toLowerCase().endsWith(`.${extension}`);
}

/** Files that are taken from what is dropped, at most; a folder may hold anything. */
const MOST_DROPPED = 5000;

/** Opens what was dropped: files, or folders with all that is in them. */
export async function openDropped(transfer: DataTransfer): Promise<void> {
  // Both lists are empty once this event is over.
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter((entry) => entry != null);
  const plain = [...transfer.files].map(placed);
  if (!entries.some((entry) => entry.isDirectory)) {
    await take(plain);
    return;
  }
  const found: PlacedFile[] = [];
  const open = entries;
  for (let entry = open.pop(); entry !== undefined && found.length < MOST_DROPPED; entry = open.pop()) {
    try {
      if (entry.isDirectory) open.push(...(await entriesIn(entry as FileSystemDirectoryEntry)));
      else found.push({ path: entry.fullPath.replace(/^\//, ""), file: await fileOf(entry as FileSystemFileEntry) });
    } catch {
      // What cannot be read is missing, which the server tells where it matters.
    }
  }
  await take(found.sort((a, b) => (a.path < b.path ? -1 : 1)));
}

function placed(file: File): PlacedFile {
  return { path: file.webkitRelativePath || file.name, file };
}

/** All entries of a folder; a browser hands them out in parts. */
async function entriesIn(folder: FileSystemDirectoryEntry): Promise<FileSystemEntry[]> {
  const reader = folder.createReader();
  const found: FileSystemEntry[] = [];
  for (;;) {
    const part = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
    if (part.length === 0 || found.length > MOST_DROPPED) return found;
    found.push(...part);
  }
}

function fileOf(entry: FileSystemFileEntry): Promise<File> {
  return new Promise((resolve, reject) => entry.file(resolve, reject));
}

/** Saves the model in its current shape. */
export async function exportModel(format: Format): Promise<void> {
  const open = s.doc.peek();
  if (open === undefined) return;
  s.busy.value = { title: `Writing ${format}` };
  try {
    // What was typed last is part of it.
    await allAnswered();
    const files = await open.session.files(format);
    const main = `${open.name.replace(/\.[a-z]+$/i, "")}-bent.${format}`;
    for (const [name, blob] of files) save(blob, name === "" ? main : (name.split("/").at(-1) ?? name));
    const folders = [...files.keys()].filter((name) => name.includes("/"));
    if (folders.length > 0) {
      s.note("info", "Files go into folders", `${format} names ${folders.join(", ")}; a glb needs no other file.`);
    }
  } catch (error) {
    s.fail("The model was not written", error);
  } finally {
    s.busy.value = undefined;
  }
}

function save(blob: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 30_000);
}
