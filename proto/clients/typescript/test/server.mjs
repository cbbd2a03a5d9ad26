/** The server that tests talk to: `PLIANT_SERVER` names a running one, else the one that is built is started. */

import { execFileSync, spawn } from "node:child_process";
import { existsSync, mkdtempSync, rmSync } from "node:fs";
import net from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";

const built = ["release", "debug"].map((kind) => new URL(`../../../../target/${kind}/pliant`, import.meta.url).pathname);
const binary = [process.env.PLIANT_BIN, ...built].find((path) => path !== undefined && existsSync(path));

/** Why tests against a server of their own cannot run, if so. */
export const skipOwn = binary === undefined ? "there is no program; cargo build makes one" : false;

/** Why tests against any server cannot run, if so. */
export const skip =
  process.env.PLIANT_SERVER === undefined && binary === undefined ? "there is no server; cargo build makes one" : false;

/** A new token, and the lines by which a server knows it. */
export function newToken(tenant) {
  const [token, lines] = execFileSync(binary, ["token", tenant], { encoding: "utf8" }).split("\n\n");
  return { token, lines };
}

/** Where the server is, and how to end it. Keys of its configuration ask for one of its own. */
export async function start(...keys) {
  if (keys.length === 0 && process.env.PLIANT_SERVER !== undefined) return { url: process.env.PLIANT_SERVER, stop: () => undefined };
  const { url, child } = await serve("127.0.0.1:0", keys);
  return { url, stop: () => child.kill() };
}

/** A server that keeps its sessions in a folder, and is on the same port again after `restart(signal)`. */
export async function startKept(...keys) {
  const folder = mkdtempSync(join(tmpdir(), "pliant-"));
  const probe = net.createServer();
  const port = await new Promise((resolve) => probe.listen(0, "127.0.0.1", () => resolve(probe.address().port)));
  await new Promise((resolve) => probe.close(resolve));
  const run = () => serve(`127.0.0.1:${port}`, ["--data-dir", join(folder, "data"), ...keys]);
  let { url, child } = await run();
  const end = async (signal) => {
    const ended = new Promise((resolve) => child.once("exit", (code, by) => resolve(code ?? by)));
    child.kill(signal);
    return ended;
  };
  return {
    url,
    end,
    /** Ends it by a signal and starts it again; answers how it ended. */
    restart: async (signal) => {
      const ended = await end(signal);
      ({ child } = await run());
      return ended;
    },
    stop: async () => {
      if (child.exitCode === null && child.signalCode === null) await end("SIGKILL");
      rmSync(folder, { recursive: true, force: true });
    },
  };
}

async function serve(address, keys) {
  const child = spawn(binary, ["serve", "--listen", address, ...keys]);
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
  return { url, child };
}
