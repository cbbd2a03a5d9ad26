/** A folder of files on a port of its own, as any static server would give them out. */

import { readFile } from "node:fs/promises";
import http from "node:http";
import path from "node:path";

const TYPES = { ".html": "text/html", ".js": "text/javascript" };

/** Starts to serve; answers the address and what stops it. */
export async function serveFolder(folder) {
  const files = http.createServer(async (request, response) => {
    const { pathname } = new URL(request.url, "http://page");
    const name = pathname === "/" ? "/index.html" : path.normalize(pathname);
    const body = await readFile(path.join(folder, name)).catch(() => undefined);
    response.writeHead(body === undefined ? 404 : 200, { "content-type": TYPES[path.extname(name)] ?? "application/octet-stream" });
    response.end(body);
  });
  await new Promise((resolve) => files.listen(0, "127.0.0.1", resolve));
  return { url: `http://127.0.0.1:${files.address().port}/`, stop: () => files.close() };
}
