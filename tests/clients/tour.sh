#!/usr/bin/env bash
# A session from first to last over HTTP: tour.sh [SERVER]. Leaves bent.glb and bent.obj behind.
set -euo pipefail
server=${1:-http://127.0.0.1:7411}
json='content-type: application/json'

# A model to play with: the built-in creature. Any glb, gltf, obj, ply, off, stl, 3mf, fbx, splat or spz will do.
curl -sSf "$server/v1/sample.glb" -o creature.glb

# Open a session: the body is the model, the answer describes it.
session=$(curl -sSf "$server/v1/sessions?label=tour" -H 'content-type: model/gltf-binary' --data-binary @creature.glb)
id=$(python3 -c 'import json, sys; print(json.load(sys.stdin)["id"])' <<< "$session")

# Say which parts you hold: the feet stay, the head moves.
curl -sSf -X PUT "$server/v1/sessions/$id/handles" -H "$json" -o /dev/null -d '{"handles": [
  {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.14}}},
  {"id": "head", "region": {"sphere": {"center": [0.76, 1.22, 0], "radius": 0.36}}}]}'

# Turn the head by 0.8 rad about the vertical axis and lift it a little; the answer is the bent model.
curl -sSf "$server/v1/sessions/$id/solve" -H "$json" -H 'accept: model/gltf-binary' -o bent.glb -d '{
  "pose": {"handles": [{"id": "head", "pose": {"rotationVector": [0, 0.8, 0], "translation": [0, 0.1, 0]}}]},
  "options": {"tolerance": 1e-6}}'

# Undo and redo. Both restore every bit.
curl -sSf -X POST "$server/v1/sessions/$id/undo" -o /dev/null
curl -sSf -X POST "$server/v1/sessions/$id/redo" -o /dev/null

# The same shape in another format, and its bare vertex buffer (float32 x, y, z).
curl -sSf "$server/v1/sessions/$id/model?format=obj" -o bent.obj
curl -sSf "$server/v1/sessions/$id/positions" -o bent.f32

curl -sSf -X DELETE "$server/v1/sessions/$id"
echo "bent.glb: $(wc -c < bent.glb) bytes, $(($(wc -c < bent.f32) / 12)) vertices"
