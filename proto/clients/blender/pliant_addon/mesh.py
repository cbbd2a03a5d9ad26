"""Meshes in and shape keys out.

Reads the rest shape of an object and writes results beside it; never changes vertices, faces or their order.
"""

from __future__ import annotations

import bpy
import numpy as np

#: The shape key that drags and solves write to.
KEY = "Pliant"


class Refusal(Exception):
    """Why an object cannot be deformed, in words for its owner."""


def check(object: bpy.types.Object | None, depsgraph: bpy.types.Depsgraph) -> None:
    """Refuses what has no mesh, or whose modifiers show other vertices than the mesh has."""
    if object is None or object.type != "MESH":
        raise Refusal("select a mesh object")
    if object.mode == "EDIT":
        raise Refusal("leave Edit Mode first: Pliant uses the mesh of Object Mode")
    if not object.data.polygons:
        raise Refusal(f'"{object.name}" has no faces')
    mine = len(object.data.vertices)
    shown = len(object.evaluated_get(depsgraph).data.vertices)
    if shown != mine:
        names = ", ".join(f'"{modifier.name}"' for modifier in object.modifiers if modifier.show_viewport)
        raise Refusal(
            f"the modifiers {names} change the vertex count from {mine} to {shown}, and a shape key cannot: "
            "apply the one that does, or disable it in the viewport"
        )


def rest(object: bpy.types.Object) -> np.ndarray:
    """The basis shape, (vertices, 3), in the object's own space."""
    keys = object.data.shape_keys
    source = object.data.vertices if keys is None else keys.reference_key.data
    flat = np.empty(3 * len(source), np.float32)
    source.foreach_get("co", flat)
    return flat.reshape(-1, 3)


def triangles(object: bpy.types.Object) -> np.ndarray:
    """The faces as triangles, (triangles, 3)."""
    object.data.calc_loop_triangles()
    flat = np.empty(3 * len(object.data.loop_triangles), np.int32)
    object.data.loop_triangles.foreach_get("vertices", flat)
    return flat.reshape(-1, 3)


def selected(object: bpy.types.Object) -> list[int]:
    """The vertices that are selected in Edit Mode, also after it was left."""
    flags = np.empty(len(object.data.vertices), bool)
    object.data.vertices.foreach_get("select", flags)
    return np.flatnonzero(flags).tolist()


def group_weights(object: bpy.types.Object, group: str) -> np.ndarray:
    """The weight of every vertex in a vertex group; 0 outside it."""
    found = object.vertex_groups.get(group)
    if found is None:
        raise Refusal(f'"{object.name}" has no vertex group "{group}"')
    weights = np.zeros(len(object.data.vertices), np.float32)
    for vertex in object.data.vertices:
        for member in vertex.groups:
            if member.group == found.index:
                weights[vertex.index] = member.weight
    if not np.any(weights > 0):
        raise Refusal(f'the vertex group "{group}" is empty')
    return weights


def key(object: bpy.types.Object, name: str = KEY) -> bpy.types.ShapeKey:
    """The shape key of that name; made beside the basis where it is missing."""
    if object.data.shape_keys is None:
        object.shape_key_add(name="Basis", from_mix=False)
    found = object.data.shape_keys.key_blocks.get(name)
    return found if found is not None else object.shape_key_add(name=name, from_mix=False)


def shape(key: bpy.types.ShapeKey) -> np.ndarray:
    """The positions of a shape key, (vertices, 3)."""
    flat = np.empty(3 * len(key.data), np.float32)
    key.data.foreach_get("co", flat)
    return flat.reshape(-1, 3)


def write(object: bpy.types.Object, key: bpy.types.ShapeKey, positions: np.ndarray, *, value: float = 1.0) -> None:
    """Puts positions into a shape key and shows them."""
    if positions.shape != (len(key.data), 3):
        raise Refusal(f"the result has {len(positions)} vertices, the mesh {len(key.data)}: it was edited meanwhile")
    key.data.foreach_set("co", np.ascontiguousarray(positions, np.float32).ravel())
    key.value = value
    object.data.update()
