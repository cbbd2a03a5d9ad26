#!/usr/bin/env bash
# The program of a release's archive on a root that has nothing else: bare-root.sh FOLDER. It runs as a user without rights who may
# write one folder: no shell, no compiler, no certificates, no /proc, no /tmp. Needs root, for chroot; a static program gets no library,
# another one those that it names.
set -euo pipefail
files=$(cd "$1" && pwd)
suite=$(cd "$(dirname "$0")/../../deploy/ci/sample-suite" && pwd)
[ "$(id -u)" = 0 ] || { echo "SKIPPED: not root"; exit 0; }
place=$(mktemp -d)
server=
trap '[ -z "$server" ] || kill "$server" 2> /dev/null || true; rm -rf "$place"' EXIT
chmod 755 "$place"
root=$place/root
mkdir -p "$root/app" "$root/data"
tar -xJf "$(find "$files" -name "pliant-*-linux-$(uname -m).tar.xz")" -C "$root/app" --strip-components=1
libraries=$(ldd "$root/app/pliant" 2> /dev/null | grep -o '/[^ ]*' || true)
for library in $libraries; do
  install -D "$library" "$root$library"
done
echo "libraries: $(wc -w <<< "$libraries")"
cp -r "$suite" "$root/data/suite"
cat > "$root/data/job.json" << 'END'
{"handles": [
  {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.14}}},
  {"id": "head", "region": {"sphere": {"center": [0.76, 1.22, 0], "radius": 0.36}}}],
 "steps": [{"pose": {"handles": [{"id": "head", "pose": {"rotationVector": [0, 0.8, 0]}}]}}]}
END
chown -R 10001:10001 "$root/data"
alone=(env -i "$(command -v chroot)" --userspec=10001:10001 "$root" /app/pliant)

"${alone[@]}" --version
"${alone[@]}" sample creature -o /data/creature.glb
"${alone[@]}" deform /data/creature.glb --job /data/job.json -o /data/bent.glb
echo "deformed: $(head -c 4 "$root/data/bent.glb")"
"${alone[@]}" check /data/suite

"${alone[@]}" serve --data-dir /data/sessions --listen 127.0.0.1:0 --log warn > "$place/said" &
server=$!
for _ in $(seq 100); do
  grep -q "listening on" "$place/said" && break
  kill -0 "$server" || { wait "$server"; exit 1; }
  sleep 0.1
done
url=$(sed -n 's/^listening on //p' "$place/said")
"${alone[@]}" health "$url"
curl -sSf -X POST "$url/v1/sessions?sample=creature" | grep -o '"revision":"[0-9]*"'
curl -sSf "$url/" -o /dev/null && echo "the page is served" || echo "the page is not in this build"
kill "$server"
wait "$server"
server=
echo "stopped"
