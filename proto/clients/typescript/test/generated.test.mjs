/** The messages in src/gen/ are those of the schema. */

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";
import { test } from "node:test";

const folder = new URL("..", import.meta.url).pathname;

test("npm run generate changes nothing", (context) => {
  const out = mkdtempSync(path.join(tmpdir(), "pliant-generated-"));
  try {
    const done = spawnSync("npm", ["run", "--silent", "generate", "--", "--output", out], { cwd: folder, encoding: "utf8" });
    if (done.status !== 0 && /ENOTFOUND|EAI_AGAIN|ECONNREFUSED|ETIMEDOUT|ENOTCACHED|ECONNRESET/.test(done.stderr)) {
      context.skip("buf, which reads the schema, cannot be fetched");
      return;
    }
    assert.equal(done.status, 0, done.stderr);
    const file = "src/gen/pliant/v1/pliant_pb.ts";
    const [here, made] = [folder, out].map((root) => readFileSync(path.join(root, file), "utf8"));
    assert.ok(here === made, "the schema has changed; npm run generate brings src/gen/ up to date");
  } finally {
    rmSync(out, { recursive: true });
  }
});
