import { readdir, readFile, stat, writeFile } from "node:fs/promises";
import path from "node:path";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";
import { type Plugin, defineConfig } from "vite";

/** The client is used from its sources, so that the page needs no second build. */
const client = fileURLToPath(new URL("../../../proto/clients/typescript/src/index.ts", import.meta.url));
/** The decoder of compressed buffer views as plain script: the page's policy allows no WebAssembly. */
const meshopt = fileURLToPath(new URL("node_modules/meshoptimizer/meshopt_decoder_reference.js", import.meta.url));
/** Where `npm run dev` finds a server to talk to. */
const server = process.env["PLIANT_SERVER"] ?? "http://127.0.0.1:7411";

/** Files above this are also written compressed, as the server sends them to those who can read it. */
const WORTH_PACKING = 1024;

/** Writes `NAME.gz` beside each larger file of the page. */
function packed(): Plugin {
  let folder = "";
  return {
    name: "packed",
    apply: "build",
    configResolved: (config) => {
      folder = path.resolve(config.root, config.build.outDir);
    },
    closeBundle: async () => {
      for (const name of await readdir(folder, { recursive: true })) {
        const file = path.join(folder, name);
        const facts = await stat(file);
        if (facts.isFile() && facts.size > WORTH_PACKING) {
          await writeFile(`${file}.gz`, gzipSync(await readFile(file), { level: 9 }));
        }
      }
    },
  };
}

export default defineConfig({
  base: "./",
  plugins: [packed()],
  resolve: { alias: { "pliant-client": client, "meshopt-decoder": meshopt }, dedupe: ["@bufbuild/protobuf"] },
  build: {
    target: "es2023",
    outDir: process.env["PLIANT_VIEWER_OUT"] ?? "dist",
    emptyOutDir: true,
    // Everything is served as a file of its own: the page's policy allows nothing inline.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 1500,
    rollupOptions: {
      output: {
        entryFileNames: "assets/[name]-[hash].js",
        chunkFileNames: "assets/[name]-[hash].js",
        assetFileNames: "assets/[name]-[hash][extname]",
      },
    },
  },
  server: {
    proxy: { "/v1": { target: server, ws: true } },
    fs: { allow: [fileURLToPath(new URL(".", import.meta.url)), fileURLToPath(new URL("../../../proto/clients/typescript", import.meta.url))] },
  },
});
