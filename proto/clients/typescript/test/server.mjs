/** The server that tests talk to: `PLIANT_SERVER` names a running one, else the one that is built is started. */

import { spawn } from "node:child_process";
import { existsSync } from "node:fs";

const built = ["release", "debug"].map((kind) => new URL(`../../../../target/${kind}/pliant`, import.meta.url).pathname);
const binary = [process.env.PLIANT_BIN, ...built].find((path) => path !== undefined && existsSync(path));

/** Why tests against a server cannot run, if so. */
export const skip =
  process.env.PLIANT_SERVER === undefined && binary === undefined ? "there is no server; cargo build makes one" : false;

/** Where the server is, and how to end it. */
export async function start() {
  if (process.env.PLIANT_SERVER !== undefined) return { url: process.env.PLIANT_SERVER, stop: () => undefined };
  const child = spawn(binary, ["serve", "--listen", "127.0.0.1:0"]);
  const url = await new Promise((resolve, reject) => {
    let said = "";
    const listen = (text) => {
      said += text;
      const found = /127\.0\.0\.1:(\d{2,})/.exec(said);
      if (found !== null) resolve(`http://127.0.0.1:${found[1]}`);
    };
    child.stdout.on("data", listen);
    child.stderr.on("data", listen);
    child.on("exit", (code) => reject(new Error(`the server ended with ${code}: ${said}`)));
  });
  return { url, stop: () => child.kill() };
}
