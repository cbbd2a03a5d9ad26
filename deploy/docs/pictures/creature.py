#!/usr/bin/env python3
"""Draws deploy/docs/pictures/creature.png, the moving picture of README.md, with a built pliant.

usage: creature.py PLIANT CREATURE.glb OUT.png      (needs Pillow; the creature is `GET /v1/sample.glb` of a running server)
"""

import json
import math
import pathlib
import subprocess
import sys
import tempfile

from PIL import Image, ImageOps

FRAMES = 20
# The first frame is what a reader sees whose program does not play pictures: one with the head turned.
FIRST = 4
HANDLES = [
    {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.14}}},
    {"id": "head", "region": {"sphere": {"center": [0.76, 1.22, 0], "radius": 0.36}}},
    {"id": "tail", "region": {"sphere": {"center": [-1.0, 1.06, 0], "radius": 0.16}}},
]


def job(frame: int) -> dict:
    """The pose of one frame: the head looks around and up, the tail wags."""
    angle = 2 * math.pi * frame / FRAMES
    side, lift = math.sin(angle), 0.5 - 0.5 * math.cos(angle)
    head = {"rotationVector": [0, 0.9 * side, 0.25 * lift], "translation": [0.05 * lift, 0.22 * lift, 0]}
    tail = {"rotationVector": [0, -0.6 * side, -0.5 * lift], "translation": [0.05 * lift, 0.25 * lift, 0.35 * side]}
    pose = {"handles": [{"id": "head", "pose": head}, {"id": "tail", "pose": tail}]}
    return {"handles": HANDLES, "steps": [{"pose": pose}]}


def main(pliant: str, creature: str, out: str) -> None:
    """Deforms and draws every frame, and joins them."""
    frames = []
    with tempfile.TemporaryDirectory() as folder:
        place = pathlib.Path(folder)
        for frame in range(FIRST, FIRST + FRAMES):
            (place / "job.json").write_text(json.dumps(job(frame)))
            quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "check": True}
            bent, drawn = str(place / "bent.glb"), str(place / "drawn.png")
            subprocess.run([pliant, "deform", creature, "--job", str(place / "job.json"), "-o", bent, "--force"], **quiet)
            view = ["--size", "420x360", "--view", "25,12"]
            subprocess.run([pliant, "render", bent, "--before", creature, *view, "-o", drawn, "--force"], **quiet)
            small = Image.open(drawn).convert("RGB").resize((630, 270), Image.LANCZOS)
            frames.append(ImageOps.posterize(small, 6))
    frames[0].save(out, save_all=True, append_images=frames[1:], duration=90, loop=0, optimize=True)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(*sys.argv[1:])
