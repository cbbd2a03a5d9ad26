/** The messages in src/gen/ are those of the schema. */

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { test } from "node:test";

const folder = new URL("..", import.meta.url).pathname;
const buf = path.join(folder, "node_modules/.bin/buf");
const skip = existsSync(buf) ? false : "buf is not installed; npm ci here installs it";

test("npm run generate changes nothing", { skip }, () => {
  const out = mkdtempSync(path.join(tmpdir(), "pliant-generated-"));
  try {
    const PATH = `${path.join(folder, "node_modules/.bin")}${path.delimiter}${process.env.PATH}`;
    execFileSync(buf, ["generate", "--output", out], { cwd: folder, env: { ...process.env, PATH } });
    const file = "src/gen/pliant/v1/pliant_pb.ts";
    const [here, made] = [folder, out].map((root) => readFileSync(path.join(root, file), "utf8"));
    assert.ok(here === made, "the schema has changed; npm run generate brings src/gen/ up to date");
  } finally {
    rmSync(out, { recursive: true });
  }
});
