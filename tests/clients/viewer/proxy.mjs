/**
 * Serves a built page and passes its calls on to a server, with the policy that the server itself would send. For a
 * server that was built without the viewer, and for a page that changed since it was built.
 */

import { readFile } from "node:fs/promises";
import http from "node:http";
import net from "node:net";
import path from "node:path";

const TYPES = { ".html": "text/html; charset=utf-8", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml" };

export const POLICY =
  "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; " +
  "base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/**
 * Listens on a free port; answers its address, how to cut the open WebSockets, and how to stop. Without a folder
 * everything comes from the server. `target` may change between calls.
 */
export async function serve(folder, target) {
  const sockets = new Set();
  const server = http.createServer(async (request, response) => {
    const { pathname } = new URL(request.url, "http://page");
    const file = pathname === "/" ? "index.html" : pathname.slice(1);
    if (folder !== undefined && !pathname.startsWith("/v1/") && !file.includes("..")) {
      try {
        const body = await readFile(path.join(folder, file));
        response.writeHead(200, {
          "content-type": TYPES[path.extname(file)] ?? "application/octet-stream",
          "content-security-policy": POLICY,
        });
        response.end(body);
        return;
      } catch {
        // Not of the page: the server may know it.
      }
    }
    const { hostname, port } = new URL(target());
    const passed = http.request({ hostname, port, path: request.url, method: request.method, headers: request.headers }, (answer) => {
      response.writeHead(answer.statusCode, answer.headers);
      answer.pipe(response);
    });
    passed.on("error", () => response.destroy());
    request.pipe(passed);
  });
  server.on("upgrade", (request, socket, head) => {
    const { hostname, port } = new URL(target());
    const passed = net.connect(Number(port), hostname, () => {
      const headers = [];
      for (let k = 0; k < request.rawHeaders.length; k += 2) headers.push(`${request.rawHeaders[k]}: ${request.rawHeaders[k + 1]}`);
      passed.write(`${request.method} ${request.url} HTTP/1.1\r\n${headers.join("\r\n")}\r\n\r\n`);
      passed.write(head);
      passed.pipe(socket).pipe(passed);
    });
    sockets.add(socket);
    passed.on("error", () => socket.destroy());
    passed.on("close", () => socket.destroy());
    socket.on("error", () => passed.destroy());
    socket.on("close", () => {
      sockets.delete(socket);
      passed.destroy();
    });
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  return {
    url: `http://127.0.0.1:${server.address().port}`,
    cut: () => {
      for (const socket of sockets) socket.destroy();
    },
    stop: () => {
      server.closeAllConnections();
      server.close();
    },
  };
}
