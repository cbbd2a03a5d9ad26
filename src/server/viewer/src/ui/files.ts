/** Files in and out of the page. */

import { EXTENSIONS, openFiles } from "../app/opening.ts";
import * as s from "../app/signals.ts";
import type { Format } from "pliant-client";

/** Asks for a model with the browser's file picker. */
export function pickFiles(): void {
  const input = document.createElement("input");
  input.type = "file";
  input.multiple = true;
  // Companion files have any name, so the list of extensions is a hint that also lets buffers and images through.
  input.accept = [...EXTENSIONS.map((extension) => `.${extension}`), ".bin", ".png", ".jpg", ".jpeg"].join(",");
  input.onchange = () => void openFiles([...(input.files ?? [])]);
  input.click();
}

/** Saves the model in its current shape. */
export async function exportModel(format: Format): Promise<void> {
  const open = s.doc.peek();
  if (open === undefined) return;
  s.busy.value = { title: `Writing ${format}` };
  try {
    const blob = await open.session.model(format);
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = `${open.name.replace(/\.[a-z]+$/i, "")}-bent.${format}`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 30_000);
  } catch (error) {
    s.fail("The model was not written", error);
  } finally {
    s.busy.value = undefined;
  }
}
