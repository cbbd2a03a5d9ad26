/**
 * Builds the package where it is taken in from its folder, as by `npm install PATH` or `npm ci` here: npm links the folder and asks it
 * to prepare itself, but fetches none of its packages. Does nothing that is done already.
 */

import { execFileSync } from "node:child_process";
import { existsSync, readdirSync, statSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

const here = fileURLToPath(new URL(".", import.meta.url));
const COMPILER = join(here, "node_modules/typescript/bin/tsc");
const NEEDED = [COMPILER, ...["@bufbuild/protobuf", "@types/three"].map((name) => join(here, "node_modules", name, "package.json"))];
/** Settings of the npm that asks, which are about the place that it installs into. */
const ELSEWHERE = /^npm_config_(prefix|local_prefix|global|location|omit|include|only|production|package_lock|save.*)$/i;

if (!NEEDED.every(existsSync)) {
  const env = Object.fromEntries(Object.entries(process.env).filter(([name]) => !ELSEWHERE.test(name) && name !== "NODE_ENV"));
  const npm = process.env.npm_execpath;
  const wanted = ["ci", "--ignore-scripts", "--include=dev", "--no-audit", "--no-fund", "--prefer-offline"];
  // The npm that asks, where there is one: it is found also where no npm is in PATH.
  if (npm?.endsWith(".js")) execFileSync(process.execPath, [npm, ...wanted], { cwd: here, env, stdio: "inherit" });
  else execFileSync("npm", wanted, { cwd: here, env, stdio: "inherit", shell: process.platform === "win32" });
}

/** When the newest file was written of those that the build is made from. */
function newest(folder) {
  const times = readdirSync(join(here, folder), { recursive: true }).map((name) => statSync(join(here, folder, name)).mtimeMs);
  return Math.max(...times);
}

const sources = Math.max(newest("src"), ...["tsconfig.json", "tsconfig.build.json"].map((name) => statSync(join(here, name)).mtimeMs));
const built = join(here, "dist/index.js");
if (!existsSync(built) || statSync(built).mtimeMs < sources) {
  execFileSync(process.execPath, [COMPILER, "-p", "tsconfig.build.json"], { cwd: here, stdio: "inherit" });
}
