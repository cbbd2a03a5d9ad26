/** A pliant server for a test: started on a port of its own, stopped, started again on the same port. */

import { spawn } from "node:child_process";
import net from "node:net";

/** Where pliant is; `PLIANT_BIN` names another. */
export const BINARY = process.env.PLIANT_BIN ?? new URL("../../../target/release/pliant", import.meta.url).pathname;

async function freePort() {
  const probe = net.createServer();
  await new Promise((resolve) => probe.listen(0, "127.0.0.1", resolve));
  const { port } = probe.address();
  await new Promise((resolve) => probe.close(resolve));
  return port;
}

export class Server {
  #child;
  #log = "";
  constructor(port) {
    this.port = port;
    this.url = `http://127.0.0.1:${port}`;
  }

  /** A server, and more keys of its configuration. */
  static async start(...keys) {
    const server = new Server(await freePort());
    server.keys = keys;
    await server.start();
    return server;
  }

  async start() {
    const keys = this.keys ?? [];
    const drain = keys.includes("--drain-deadline") ? [] : ["--drain-deadline", "500ms"];
    const child = spawn(BINARY, ["serve", "--listen", `127.0.0.1:${this.port}`, ...drain, ...keys]);
    this.#child = child;
    for (const stream of [child.stdout, child.stderr]) stream.on("data", (text) => (this.#log += text));
    const exited = new Promise((_, reject) => {
      child.on("error", reject);
      child.on("exit", (code) => reject(new Error(`the server ended with ${code}:\n${this.#log}`)));
    });
    exited.catch(() => undefined);
    const ready = async () => {
      for (;;) {
        try {
          if ((await fetch(`${this.url}/readyz`)).ok) return;
        } catch {
          // Not listening yet.
        }
        await new Promise((resolve) => setTimeout(resolve, 50));
      }
    };
    await Promise.race([ready(), exited]);
  }

  /** Ends it at once, as a crash would. Answers its exit code or the signal. */
  kill() {
    return this.#end("SIGKILL");
  }

  /** Asks it to end, and waits until it has. */
  stop() {
    return this.#end("SIGTERM");
  }

  async #end(signal) {
    const child = this.#child;
    if (child === undefined || child.exitCode !== null || child.signalCode !== null) return undefined;
    const gone = new Promise((resolve) => child.once("exit", (code, by) => resolve(code ?? by)));
    child.kill(signal);
    return gone;
  }

  /** The JSON that a call answers; fails with the server's text. */
  async json(method, path, body, type = "application/json") {
    const response = await this.#call(method, path, body, type, "application/json");
    return response.json();
  }

  /** The floats that a call answers. */
  async floats(method, path, body) {
    const response = await this.#call(method, path, body, "application/json", "application/octet-stream");
    return new Float32Array(await response.arrayBuffer());
  }

  async #call(method, path, body, type, accept) {
    const response = await fetch(this.url + path, {
      method,
      headers: { accept, ...(body === undefined ? {} : { "content-type": type }) },
      body: body === undefined || body instanceof Uint8Array ? body : JSON.stringify(body),
    });
    if (!response.ok) throw new Error(`${method} ${path}: ${response.status} ${await response.text()}`);
    return response;
  }
}
