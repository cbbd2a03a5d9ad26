#!/usr/bin/env bash
# From a release's files to a deformed model, in places where nothing else of pliant is: first-model.sh FOLDER. Nothing is compiled,
# no cache is used, and of each way it is said how long it took.
set -euo pipefail
files=$(cd "$1" && pwd)
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"
unset PLIANT_BIN PLIANT_SERVER

# By pip: the wheel brings the program.
begun=$(date +%s.%N)
python3 -m venv python
python/bin/pip install --quiet --disable-pip-version-check --no-cache-dir --only-binary :all: "$files"/pliant-*linux*"$(uname -m)"*.whl
python/bin/python - << 'END'
import pliant

with pliant.connect() as client, client.open(client.sample()) as session:
    session.handle("feet", half_space=((0, -1, 0), -0.14))
    session.handle("head", sphere=((0.76, 1.22, 0), 0.36))
    bent = session.solve({"head": {"rotation_vector": (0, 0.8, 0)}})
    session.export("turned.glb")
print(f"pip: {len(bent)} vertices, {open('turned.glb', 'rb').read(4)}")
END
# The nodes for ComfyUI, beside it: loaded as ComfyUI loads a folder of custom_nodes.
python3 -m zipfile -e "$files"/pliant-comfyui-*.zip custom_nodes
python/bin/python - << 'END'
import importlib.util

import pliant

with pliant.connect() as client, open("creature.glb", "wb") as file:
    file.write(client.sample())
spec = importlib.util.spec_from_file_location("pack", "custom_nodes/pliant-comfyui/__init__.py")
pack = importlib.util.module_from_spec(spec)
__import__("sys").modules["pack"] = pack
spec.loader.exec_module(pack)
[model] = pack.OpenMesh().open("creature.glb")
[path] = pack.ExportMesh().export(model, "comfy", "glb")["result"]
with pliant.open(path) as session:
    print(f"comfyui: {len(pack.NODE_CLASS_MAPPINGS)} nodes, {session.vertices} vertices")
END
python3 -c "import sys; print(f'pip: {float(sys.argv[2]) - float(sys.argv[1]):.1f} s')" "$begun" "$(date +%s.%N)"

# By npm: the program is in the archive for Linux, or else in the wheel.
command -v npm > /dev/null || { echo "npm: SKIPPED: npm is not installed"; exit 0; }
begun=$(date +%s.%N)
archive=$(find "$files" -name "pliant-*-linux-$(uname -m).tar.xz")
program=$place/python/bin/pliant
if [ -n "$archive" ]; then
  mkdir program
  tar -xJf "$archive" -C program --strip-components=1
  program=$place/program/pliant
fi
mkdir node
cd node
echo '{"type": "module", "private": true}' > package.json
npm install --silent --no-audit --no-fund --ignore-scripts --cache "$place/npm" "$files"/pliant-client-*.tgz
cat > first.js << 'END'
import { spawn } from "node:child_process";
import { writeFile } from "node:fs/promises";
import { Client } from "pliant-client";

const server = spawn(process.argv[2], ["serve", "--listen", "127.0.0.1:0", "--log", "warn"], { stdio: ["ignore", "pipe", "inherit"] });
const line = await new Promise((resolve) => server.stdout.once("data", (bytes) => resolve(String(bytes))));
const pliant = new Client({ url: line.trim().replace("listening on ", "") });
const session = await pliant.sample();
await session.setHandles({
  handles: [
    { id: "feet", region: { halfSpace: { normal: [0, -1, 0], offset: -0.14 } } },
    { id: "head", region: { sphere: { center: [0.76, 1.22, 0], radius: 0.36 } } },
  ],
});
await session.solve([{ id: "head", pose: { rotationVector: [0, 0.8, 0] } }]);
const turned = Buffer.from(await (await session.model("glb")).arrayBuffer());
await writeFile("turned.glb", turned);
console.log(`npm: ${(await session.positions()).length / 3} vertices, ${turned.subarray(0, 4)}`);
await session.close();
server.kill();
END
node first.js "$program"
python3 -c "import sys; print(f'npm: {float(sys.argv[2]) - float(sys.argv[1]):.1f} s')" "$begun" "$(date +%s.%N)"
