"""Point caches: frames in a PC2 file beside the .blend, shown by a Mesh Cache modifier that is first in the stack."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import bpy
import numpy as np

from . import mesh

#: The modifier that shows an animation.
MODIFIER = "Pliant Animation"


def path_for(name: str) -> Path:
    """A file beside the .blend that is not there yet: older ones stay, so that undo finds them."""
    if not bpy.data.filepath:
        raise mesh.Refusal("save the .blend file first: the point cache lies beside it")
    folder = Path(bpy.data.filepath).parent
    stem = re.sub(r"[^\w.-]+", "_", name).strip("_") or "animation"
    path, number = folder / f"{stem}.pc2", 1
    while path.exists():
        number += 1
        path = folder / f"{stem}-{number}.pc2"
    return path


class Writer:
    """Writes a PC2 file frame by frame; it has its name when all are there."""

    def __init__(self, path: Path, vertices: int, first: int, frames: int) -> None:
        self.path = path
        self._frames = frames
        self._written = 0
        self._partial = path.with_name(path.name + ".part")
        self._file = self._partial.open("wb")
        self._file.write(struct.pack("<12siiffi", b"POINTCACHE2\0", 1, vertices, first, 1.0, frames))

    def write(self, positions: np.ndarray) -> None:
        """The next frame, (vertices, 3)."""
        self._file.write(np.ascontiguousarray(positions, "<f4").tobytes())
        self._written += 1

    def finish(self) -> None:
        """Gives the file its name."""
        if self._written != self._frames:
            raise mesh.Refusal(f"{self._written} of {self._frames} frames came")
        self._file.close()
        self._partial.replace(self.path)

    def discard(self) -> None:
        """Leaves nothing behind."""
        self._file.close()
        self._partial.unlink(missing_ok=True)


def show(object: bpy.types.Object, path: Path, first: int) -> None:
    """Has a mesh shown as a cache has it, from a frame of the scene on; armature modifiers are put off meanwhile."""
    modifier = object.modifiers.get(MODIFIER)
    if modifier is None or modifier.type != "MESH_CACHE":
        modifier = object.modifiers.new(MODIFIER, "MESH_CACHE")
    object.modifiers.move(object.modifiers.find(modifier.name), 0)
    modifier.cache_format = "PC2"
    modifier.filepath = bpy.path.relpath(str(path))
    modifier.deform_mode = "OVERWRITE"
    modifier.interpolation = "LINEAR"
    modifier.time_mode = "FRAME"
    modifier.play_mode = "SCENE"
    modifier.frame_start = first
    modifier.frame_scale = 1.0
    # Positions are the mesh's own, so nothing is turned.
    modifier.forward_axis, modifier.up_axis = "POS_Y", "POS_Z"
    for other in object.modifiers:
        if other.type == "ARMATURE":
            other.show_viewport = other.show_render = False
