/** The example in README.md works as written. */

import assert from "node:assert/strict";
import { readFileSync, rmSync, writeFileSync } from "node:fs";
import { after, before, test } from "node:test";
import { skip, start } from "./server.mjs";

const script = new URL(`readme-${process.pid}.generated.mjs`, import.meta.url);
let server;

before(async () => {
  if (!skip) server = await start();
});
after(() => {
  server?.stop();
  rmSync(script, { force: true });
});

test("the example drags, commits and exports", { skip }, async () => {
  const text = readFileSync(new URL("../README.md", import.meta.url), "utf8");
  const [, example] = /```js\n([\s\S]*?)```/.exec(text);
  const said = [];
  const { log } = console;
  writeFileSync(
    script,
    example.replace('"pliant-client"', '"../dist/index.js"').replace("http://127.0.0.1:7411", server.url) + "\nexport { bent };\n",
  );
  console.log = (line) => said.push(line);
  let bent;
  try {
    ({ bent } = await import(script));
  } finally {
    console.log = log;
  }
  assert.ok(said.some((line) => line.startsWith("pose ")), said.join("\n"));
  assert.equal(said.at(-1), "revision 3: 0 triangles flipped");
  assert.equal(await bent.slice(0, 4).text(), "glTF");
});
