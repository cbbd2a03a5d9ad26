#!/usr/bin/env python3
"""Draws deploy/docs/pictures/figure.png: the built-in figure before and after its job, in the rest pose and at times of its clips.

usage: figure.py PLIANT BEFORE.glb AFTER.glb OUT.png      (needs Pillow; the models are those of cookbook-assets.md)

Clips are played here by linear blend skinning, as game engines do it, so that the picture shows what they would.
"""

import json
import math
import pathlib
import struct
import subprocess
import sys
import tempfile

from PIL import Image

LANES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
KINDS = {5121: "B", 5123: "H", 5125: "I", 5126: "f"}
# Part of the scene, clip, and seconds; no clip is the rest pose.
SHOTS = [("body", None, 0), ("lod2", None, 0), ("hull", None, 0), ("body", 0, 0.3), ("body", 0, 0.75), ("body", 1, 0.75)]
IDENTITY = ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0))


class Glb:
    """A file and its numbers."""

    def __init__(self, path: str) -> None:
        data = pathlib.Path(path).read_bytes()
        length = struct.unpack_from("<I", data, 12)[0]
        self.json, self.bytes = json.loads(data[20 : 20 + length]), data[28 + length :]

    def rows(self, accessor: int) -> list[tuple]:
        """The elements of an accessor."""
        told = self.json["accessors"][accessor]
        view = self.json["bufferViews"][told["bufferView"]]
        form = f"<{LANES[told['type']]}{KINDS[told['componentType']]}"
        start, step = view.get("byteOffset", 0) + told.get("byteOffset", 0), struct.calcsize(form)
        return [struct.unpack_from(form, self.bytes, start + i * step) for i in range(told["count"])]


def joined(above: tuple, own: tuple) -> tuple:
    """Two transforms as one: columns of axes, then the place."""
    return (*(turned(above, column) for column in own[:3]), moved(above, own[3]))


def turned(by: tuple, v: tuple) -> tuple:
    return tuple(sum(by[k][i] * v[k] for k in range(3)) for i in range(3))


def moved(by: tuple, v: tuple) -> tuple:
    return tuple(a + b for a, b in zip(turned(by, v), by[3]))


def local(translation: tuple, rotation: tuple) -> tuple:
    """A transform from a place and a unit quaternion."""
    x, y, z, w = (part / math.hypot(*rotation) for part in rotation)
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)),
        (2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)),
        (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)),
        tuple(translation),
    )


def sampled(times: list[tuple], values: list[tuple], seconds: float) -> tuple:
    """The value at a time, straight between keys."""
    after = next((k for k, (time,) in enumerate(times) if time > seconds), len(times) - 1)
    before = max(after - 1, 0)
    (start,), (end,) = times[before], times[after]
    share = min(max((seconds - start) / (end - start), 0), 1)
    return tuple(a + (b - a) * share for a, b in zip(values[before], values[after]))


def posed(file: Glb, part: str, clip: int | None, seconds: float) -> tuple[list, list, list]:
    """Positions, colours and triangles of a part."""
    nodes = file.json["nodes"]
    poses = [{"translation": n.get("translation", (0, 0, 0)), "rotation": n.get("rotation", (0, 0, 0, 1))} for n in nodes]
    if clip is not None:
        animation = file.json["animations"][clip]
        for channel in animation["channels"]:
            sampler, target = animation["samplers"][channel["sampler"]], channel["target"]
            value = sampled(file.rows(sampler["input"]), file.rows(sampler["output"]), seconds)
            poses[target["node"]][target["path"]] = value
    world = {}

    def place(node: int, above: tuple) -> None:
        world[node] = joined(above, local(**poses[node]))
        for child in nodes[node].get("children", []):
            place(child, world[node])

    for root in file.json["scenes"][0]["nodes"]:
        place(root, IDENTITY)
    node = next(n for n in nodes if n.get("name") == part)
    primitive = file.json["meshes"][node["mesh"]]["primitives"][0]
    rows = {name: file.rows(accessor) for name, accessor in primitive["attributes"].items()}
    positions = rows["POSITION"]
    if "skin" in node:
        skin = file.json["skins"][node["skin"]]
        matrices = [tuple(m[4 * c : 4 * c + 3] for c in range(4)) for m in file.rows(skin["inverseBindMatrices"])]
        joints = [joined(world[joint], matrix) for joint, matrix in zip(skin["joints"], matrices)]
        held = zip(positions, rows["JOINTS_0"], rows["WEIGHTS_0"])
        positions = [
            tuple(sum(w * moved(joints[j], p)[i] for j, w in zip(by, weights) if w > 0) for i in range(3))
            for p, by, weights in held
        ]
    corners = [corner for (corner,) in file.rows(primitive["indices"])]
    colours = rows.get("COLOR_0", [(0.5, 0.5, 0.5)] * len(positions))
    return positions, colours, [corners[i : i + 3] for i in range(0, len(corners), 3)]


def write_ply(path: pathlib.Path, positions: list, colours: list, triangles: list) -> None:
    head = f"ply\nformat ascii 1.0\nelement vertex {len(positions)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += "".join(f"property uchar {colour}\n" for colour in ("red", "green", "blue"))
    head += f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    shown = [[round(255 * min(max(c, 0), 1)) for c in colour[:3]] for colour in colours]
    rows = [" ".join(map(str, (*p, *c))) for p, c in zip(positions, shown)]
    faces = [" ".join(map(str, (3, *t))) for t in triangles]
    path.write_text(head + "\n".join(rows + faces) + "\n")


def main(pliant: str, before: str, after: str, out: str) -> None:
    """Poses and draws every shot, and joins them in two rows."""
    drawn = []
    with tempfile.TemporaryDirectory() as folder:
        place = pathlib.Path(folder)
        for shot, (part, clip, seconds) in enumerate(SHOTS):
            for name, model in (("before", before), ("after", after)):
                write_ply(place / f"{name}.ply", *posed(Glb(model), part, clip, seconds))
            picture = place / f"{shot}.png"
            call = [pliant, "render", place / "after.ply", "--before", place / "before.ply", "--color", "material"]
            call += ["--view", "30,8", "--size", "320x360", "-o", picture]
            subprocess.run(call, stdout=subprocess.DEVNULL, check=True)
            drawn.append(Image.open(picture).convert("RGB"))
    width, height = drawn[0].size
    sheet = Image.new("RGB", (3 * width, 2 * height))
    for shot, picture in enumerate(drawn):
        sheet.paste(picture, (shot % 3 * width, shot // 3 * height))
    sheet.quantize(128).save(out, optimize=True)


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    main(*sys.argv[1:])
