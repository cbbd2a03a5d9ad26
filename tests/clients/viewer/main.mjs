/**
 * The viewer in a real browser: main.mjs [SCENE…]. Every scene starts from a fresh page; pictures of what they saw lie
 * in target/viewer/.
 */

import { existsSync } from "node:fs";
import { readdir } from "node:fs/promises";
import { launch } from "./browser.mjs";
import { serve } from "./proxy.mjs";
import { Server } from "./server.mjs";

const wanted = process.argv.slice(2);
const folder = new URL("scenes/", import.meta.url);
const BUILT = process.env.PLIANT_VIEWER_PAGE;

const server = await Server.start();
const proxy = BUILT === undefined ? undefined : await serve(BUILT, () => server.url);
const url = () => proxy?.url ?? server.url;
const page = await (await fetch(url())).text();
if (!page.includes('id="app"')) {
  console.log("SKIPPED: this server was built without the viewer, and PLIANT_VIEWER_PAGE names no built page");
  await server.kill();
  process.exit(0);
}
if (BUILT !== undefined && !existsSync(BUILT)) throw new Error(`${BUILT} is not there`);

const browser = await launch();
let failed = 0;
try {
  for (const file of (await readdir(folder)).sort()) {
    const { title, play } = await import(new URL(file, folder));
    const name = file.replace(".mjs", "");
    if (play === undefined || (wanted.length > 0 && !wanted.includes(name))) continue;
    const begun = performance.now();
    const lines = [];
    const log = (line) => lines.push(line);
    try {
      await play({ browser, server, url, log, folder: BUILT, named: wanted.includes(name) });
      console.log(`ok      ${name}: ${title} (${((performance.now() - begun) / 1000).toFixed(1)} s)`);
    } catch (error) {
      failed += 1;
      console.log(`FAILED  ${name}: ${title}\n${error.stack}`);
    }
    for (const line of lines) console.log(`          ${line}`);
    for (const context of browser.contexts()) await context.close();
  }
} finally {
  await browser.close();
  proxy?.stop();
  await server.kill();
}
process.exit(failed === 0 ? 0 : 1);
