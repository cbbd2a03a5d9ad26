/** The example in README.md works as written. */

import assert from "node:assert/strict";
import { readFileSync, rmSync, writeFileSync } from "node:fs";
import { after, before, test } from "node:test";
import { skip, start } from "./server.mjs";

const script = new URL(`readme-${process.pid}.generated.mjs`, import.meta.url);
const figure = new URL(`readme-${process.pid}.generated.glb`, import.meta.url);
let server;

before(async () => {
  if (!skip) server = await start();
});
after(() => {
  server?.stop();
  rmSync(script, { force: true });
  rmSync(figure, { force: true });
});

/** Runs an example of the page; what it says, and the variables that are named. */
async function run(number, names) {
  const text = readFileSync(new URL("../README.md", import.meta.url), "utf8");
  const [, example] = [...text.matchAll(/```js\n([\s\S]*?)```/g)][number];
  const said = [];
  const { log } = console;
  const here = example
    .replace('"pliant-client"', '"../dist/index.js"')
    .replace("http://127.0.0.1:7411", server.url)
    .replace("figure.glb", new URL(figure).pathname);
  writeFileSync(script, `${here}\nexport { ${names} };\n`);
  console.log = (line) => said.push(line);
  try {
    return { said, ...(await import(`${script}?${number}`)) };
  } finally {
    console.log = log;
  }
}

test("the example of an animation plays", { skip }, async () => {
  writeFileSync(figure, new Uint8Array(await (await fetch(`${server.url}/v1/sample.glb?name=figure`)).arrayBuffer()));
  const { said, played } = await run(1, "played");
  assert.match(said[0], /^1 of \d+, second 0\.00$/);
  assert.match(said.at(-1), / a second$/);
  assert.equal(await played.slice(0, 4).text(), "glTF");
});

test("the example drags, commits and exports", { skip }, async () => {
  const { said, bent } = await run(0, "bent");
  assert.ok(said.some((line) => line.startsWith("pose ")), said.join("\n"));
  assert.equal(said.at(-1), "revision 3: 0 triangles flipped");
  assert.equal(await bent.slice(0, 4).text(), "glTF");
});
