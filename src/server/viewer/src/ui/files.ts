/** Files in and out of the page. */

import { EXTENSIONS, openFiles } from "../app/opening.ts";
import * as s from "../app/signals.ts";
import type { Format, PlacedFile } from "pliant-client";

/** Asks for a model with the browser's file picker. */
export function pickFiles(): void {
  const input = document.createElement("input");
  input.type = "file";
  input.multiple = true;
  // Companion files have any name, so the list of extensions is a hint that also lets buffers and images through.
  input.accept = [...EXTENSIONS.map((extension) => `.${extension}`), ".bin", ".mtl", ".png", ".jpg", ".jpeg"].join(",");
  input.onchange = () => void openFiles([...(input.files ?? [])].map(placed));
  input.click();
}

/** Files that are taken from what is dropped, at most; a folder may hold anything. */
const MOST_DROPPED = 5000;

/** Opens what was dropped: files, or folders with all that is in them. */
export async function openDropped(transfer: DataTransfer): Promise<void> {
  // Both lists are empty once this event is over.
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter((entry) => entry != null);
  const plain = [...transfer.files].map(placed);
  if (!entries.some((entry) => entry.isDirectory)) {
    await openFiles(plain);
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
  await openFiles(found.sort((a, b) => (a.path < b.path ? -1 : 1)));
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
