"""Results: shape keys with the name that the object's settings give, one result shown at a time."""

from __future__ import annotations

import bpy
import numpy as np

from . import mesh


def name(object: bpy.types.Object) -> str:
    """What the next result is called."""
    return object.pliant.result.strip() or mesh.KEY


def show(object: bpy.types.Object, names: list[str]) -> None:
    """Shows the shape keys of one result and mutes those of the one before: both at once would add up."""
    keys = object.data.shape_keys.key_blocks
    for old in object.pliant.shown.split("\n"):
        if old in keys and old not in names:
            keys[old].mute = True
    for new in names:
        keys[new].mute = False
    object.pliant.shown = "\n".join(names)


def write(object: bpy.types.Object, called: str, positions: np.ndarray) -> None:
    """Makes positions the result of that name, and shows it."""
    mesh.write(object, mesh.key(object, called), positions)
    show(object, [called])
