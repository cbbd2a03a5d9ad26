/** The files that belong to a model: which ones it names, and where they are among files that were picked or dropped. */

/** A file with its place below the folder that was picked or dropped, such as `car/textures/paint.png`. */
export interface PlacedFile {
  readonly path: string;
  readonly file: Blob;
}

/** Bytes before the JSON of a GLB. */
const GLB_START = 20;

/**
 * The names of the files that a model refers to, relative to its folder: buffers and images of a glTF or GLB, material
 * libraries of an OBJ. These are the keys of `OpenOptions.companions`.
 */
export async function companionNames(model: Blob): Promise<string[]> {
  const start = new DataView(await model.slice(0, GLB_START).arrayBuffer());
  let json = model;
  if (start.byteLength === GLB_START && start.getUint32(0, false) === 0x676c5446) {
    json = model.slice(GLB_START, GLB_START + start.getUint32(12, true));
  } else if (!/^\s*\{/.test(await model.slice(0, 256).text())) {
    return libraryNames(await model.text());
  }
  let document: unknown;
  try {
    document = JSON.parse(await json.text());
  } catch {
    return [];
  }
  const names = new Set<string>();
  for (const item of [...items(document, "buffers"), ...items(document, "images")]) {
    const name = nameOf((item as { uri?: unknown } | null)?.uri);
    if (name !== undefined) names.add(name);
  }
  return [...names];
}

/**
 * Finds the files that a model names among others, such as those of a folder that was dropped. A name is looked up in the
 * model's own folder; where it is not there, any file of that name will do, if there is only one.
 */
export async function companionsOf(model: PlacedFile, others: readonly PlacedFile[]): Promise<Map<string, Blob>> {
  const folder = model.path.slice(0, model.path.lastIndexOf("/") + 1);
  const byPath = new Map(others.map(({ path, file }) => [path, file]));
  const found = new Map<string, Blob>();
  const names = await companionNames(model.file);
  for (const name of names) {
    const last = name.split("/").at(-1);
    const alike = others.filter(({ path }) => path.split("/").at(-1) === last);
    const file = byPath.get(folder + name) ?? (alike.length === 1 ? alike[0]?.file : undefined);
    if (file === undefined || found.has(name)) continue;
    found.set(name, file);
    // A library of materials names pictures of its own.
    if (name.toLowerCase().endsWith(".mtl")) names.push(...pictureNames(await file.text()));
  }
  return found;
}

/** The libraries that `mtllib` lines may mean: all words as one name, and each for itself. */
function libraryNames(text: string): string[] {
  const lines = [...text.matchAll(/^[ \t]*mtllib[ \t]+([^\r\n]+)/gm)].map(([, rest]) => rest?.trim() ?? "");
  const names = lines.flatMap((rest) => [rest, ...rest.split(/\s+/)]).map(insideFolder);
  return [...new Set(names.filter((name) => name !== undefined))];
}

const PICTURE =
  /^[ \t]*(?:map_\w+|bump|disp|decal|refl|norm)[ \t]+(?:-(?:[ost](?:[ \t]+[-+.\deE]+){1,3}|mm(?:[ \t]+[-+.\deE]+){1,2}|\w+[ \t]+\S+)[ \t]+)*([^\r\n]+)/gim;

/** The pictures that a library of materials names. */
function pictureNames(text: string): string[] {
  return [...text.matchAll(PICTURE)].map(([, name]) => insideFolder(name ?? "")).filter((name) => name !== undefined);
}

function insideFolder(name: string): string | undefined {
  const plain = name.trim().replaceAll("\\", "/").replace(/^\.\//, "");
  const leadsOut = plain.startsWith("/") || plain.includes(":") || plain.split("/").includes("..");
  return plain === "" || leadsOut ? undefined : plain;
}

function items(document: unknown, key: string): unknown[] {
  const list = (document as Record<string, unknown> | null)?.[key];
  return Array.isArray(list) ? list : [];
}

/** The name behind a URI; nothing for embedded data, other schemes, and what leads out of the folder. */
function nameOf(uri: unknown): string | undefined {
  if (typeof uri !== "string" || /^data:/i.test(uri)) return undefined;
  let name = uri;
  try {
    name = decodeURIComponent(uri);
  } catch {
    // A lone percent sign stands for itself.
  }
  name = name.replace(/^\.\//, "");
  const leadsOut = /^[a-z][a-z0-9+.-]*:/i.test(name) || /^[/\\]/.test(name) || name.split(/[/\\]/).includes("..");
  return name === "" || leadsOut ? undefined : name;
}
