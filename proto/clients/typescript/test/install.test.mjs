/** The package is taken in from its folder as somebody would who has cloned it: one `npm install`, and it can be imported. */

import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { cpSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { fileURLToPath } from "node:url";
import { promisify } from "node:util";

const run = promisify(execFile);
const PACKAGE = fileURLToPath(new URL("..", import.meta.url));
/** What npm says when it reaches no registry. */
const OFFLINE = /ENOTFOUND|EAI_AGAIN|ECONNREFUSED|ETIMEDOUT|ENOTCACHED|ECONNRESET/;

test("a page takes it in from a fresh checkout", async (t) => {
  const folder = mkdtempSync(join(tmpdir(), "pliant-"));
  try {
    const fresh = join(folder, "checkout");
    cpSync(PACKAGE, fresh, { recursive: true, filter: (path) => !/(node_modules|dist)$/.test(path) });
    const page = join(folder, "page");
    cpSync(join(PACKAGE, ".npmrc"), join(page, ".npmrc"));
    writeFileSync(join(page, "package.json"), '{"name": "page", "private": true, "type": "module"}');
    try {
      await run("npm", ["install", "--no-audit", "--no-fund", "--prefer-offline", "../checkout"], { cwd: page });
    } catch (error) {
      if (!OFFLINE.test(`${error.stdout}${error.stderr}`)) throw error;
      t.skip("no registry of packages is reached");
      return;
    }
    writeFileSync(join(page, "page.js"), 'import { Client } from "pliant-client";\nconsole.log(new Client({ url: "http://127.0.0.1:9" }).constructor.name);\nimport { Deformer } from "pliant-client/gen/pliant/v1/pliant_pb.js";\nimport * as gen from "pliant-client/gen/pliant/v1/pliant_pb";\nconsole.log(Deformer.typeName, gen.Deformer === Deformer);\n');
    const { stdout } = await run("node", ["page.js"], { cwd: page });
    assert.equal(stdout.trim(), "Client\npliant.v1.Deformer true", "the client, and the generated files by either name");
  } finally {
    rmSync(folder, { recursive: true, force: true });
  }
});
