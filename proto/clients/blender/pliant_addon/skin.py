"""A mesh that an armature deforms, and what its bones do over some frames, as a skinned GLB in the mesh's own space.

The server then solves the clip again from the bones' rest pose and their weights: what the armature modifier would do by
linear blend skinning. Axes stay Blender's, so that what comes back needs no turning.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from . import mesh

#: Bones that a vertex follows at most; the heaviest count.
_INFLUENCES = 8
_FLOAT, _SHORT, _INT = 5126, 5123, 5125
#: Farther from one than rounding puts it.
_SCALED = 1e-4


@dataclass(frozen=True)
class Skin:
    """The bones that move a mesh, parents before children, and how much of each every vertex follows."""

    armature: bpy.types.Object
    bones: list[str]
    #: The number of each bone's parent among them; -1 for none.
    parents: list[int]
    #: (vertices, 8): bones and their shares, the heaviest first; shares of a vertex sum to 1, or to 0 where it
    #: follows none.
    joints: np.ndarray
    weights: np.ndarray


def modifier(object: bpy.types.Object) -> bpy.types.ArmatureModifier:
    """The armature modifier of a mesh: the one that is on, else one that was put off."""
    found = [m for m in object.modifiers if m.type == "ARMATURE" and m.object is not None]
    shown = [m for m in found if m.show_viewport] or found[:1]
    if not shown:
        raise mesh.Refusal(f'"{object.name}" has no Armature modifier: an armature has to deform it')
    if len(shown) > 1:
        names = ", ".join(f'"{m.name}"' for m in shown)
        raise mesh.Refusal(f"the modifiers {names} all deform it by an armature: leave one of them on")
    return shown[0]


def skin(object: bpy.types.Object, armature: bpy.types.Object) -> Skin:
    """The bones that move the mesh: those that deform, and have a vertex group of their name."""
    groups = {group.name: group.index for group in object.vertex_groups}
    held = _held(object)
    moving = [
        bone.name
        for bone in armature.data.bones
        if bone.use_deform and bone.name in groups and np.any(held[1] == groups[bone.name])
    ]
    if not moving:
        raise mesh.Refusal(f'no vertex group of "{object.name}" is called as a bone of "{armature.name}" that deforms')
    bones = sorted(moving, key=lambda name: len(armature.data.bones[name].parent_recursive))
    number = {name: k for k, name in enumerate(bones)}
    parents = []
    for name in bones:
        above = (number.get(parent.name) for parent in armature.data.bones[name].parent_recursive)
        parents.append(next((k for k in above if k is not None), -1))
    bone_of_group = np.full(max(groups.values()) + 1, -1)
    for name in bones:
        bone_of_group[groups[name]] = number[name]
    joints, weights = _heaviest(len(object.data.vertices), held[0], bone_of_group[held[1]], held[2])
    return Skin(armature, bones, parents, joints, weights)


def _held(object: bpy.types.Object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All memberships in vertex groups: vertices, groups, weights above 0."""
    rows = [
        (vertex.index, member.group, member.weight)
        for vertex in object.data.vertices
        for member in vertex.groups
        if member.weight > 0
    ]
    table = np.array(rows, np.float64).reshape(-1, 3)
    return table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2]


def _heaviest(
    count: int, vertices: np.ndarray, bones: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    known = bones >= 0
    vertices, bones, weights = vertices[known], bones[known], weights[known]
    order = np.lexsort((bones, -weights, vertices))
    vertices, bones, weights = vertices[order], bones[order], weights[order]
    place = np.arange(len(vertices)) - np.searchsorted(vertices, vertices)
    taken = place < _INFLUENCES
    joints = np.zeros((count, _INFLUENCES), np.uint16)
    shares = np.zeros((count, _INFLUENCES), np.float64)
    joints[vertices[taken], place[taken]] = bones[taken]
    shares[vertices[taken], place[taken]] = weights[taken]
    total = shares.sum(axis=1, keepdims=True)
    return joints, (shares / np.where(total > 0, total, 1)).astype(np.float32)


def sample(object: bpy.types.Object, skin: Skin, scene: bpy.types.Scene, frames: Sequence[int]) -> np.ndarray:
    """Where each bone is at each frame, (frames, bones, 4, 4), in the mesh's space: the first is the rest pose.

    What constraints, drivers, parents and other actions do to the bones counts. The scene comes back to its frame.
    """
    back = scene.frame_current
    rest = [skin.armature.data.bones[name].matrix_local for name in skin.bones]
    found = np.empty((len(frames) + 1, len(skin.bones), 4, 4))
    try:
        for k, frame in enumerate(frames):
            scene.frame_set(frame)
            depsgraph = bpy.context.evaluated_depsgraph_get()
            armature = skin.armature.evaluated_get(depsgraph)
            between = object.evaluated_get(depsgraph).matrix_world.inverted_safe() @ armature.matrix_world
            if k == 0:
                bound = between.copy()
                found[0] = [bound @ matrix for matrix in rest]
            # As the modifier does it: into the armature's space, by the bone, and back.
            home = between.inverted_safe() @ bound
            for b, name in enumerate(skin.bones):
                turned = armature.pose.bones[name].matrix @ rest[b].inverted_safe()
                found[k + 1, b] = between @ turned @ home @ rest[b]
    finally:
        scene.frame_set(back)
    return found


def glb(object: bpy.types.Object, skin: Skin, matrices: np.ndarray, rate: float) -> bytes:
    """The mesh in the rest pose with its skin, and one clip of `matrices` (see :func:`sample`), `rate` frames a second."""
    out = _Writer()
    points = mesh.rest(object)
    attributes = {"POSITION": out.accessor(points, _FLOAT, "VEC3", bounds=True)}
    for k in range(0, _INFLUENCES, 4):
        if k > 0 and not np.any(skin.weights[:, k:] > 0):
            break
        attributes[f"JOINTS_{k // 4}"] = out.accessor(skin.joints[:, k : k + 4], _SHORT, "VEC4")
        attributes[f"WEIGHTS_{k // 4}"] = out.accessor(skin.weights[:, k : k + 4], _FLOAT, "VEC4")
    corners = out.accessor(mesh.triangles(object).reshape(-1, 1).astype(np.uint32), _INT, "SCALAR")
    # Columns after one another, as glTF has them.
    binds = np.linalg.inv(matrices[0]).transpose(0, 2, 1).reshape(-1, 16)
    local = matrices.copy()
    for k, parent in enumerate(skin.parents):
        if parent >= 0:
            local[:, k] = np.linalg.inv(matrices[:, parent]) @ matrices[:, k]
    times = out.accessor(np.arange(len(matrices) - 1).reshape(-1, 1) / rate, _FLOAT, "SCALAR", bounds=True)
    nodes: list[dict[str, Any]] = [{"mesh": 0, "skin": 0}]
    samplers, channels = [], []
    for k, name in enumerate(skin.bones):
        moved = _parts(local[:, k])
        children = [1 + c for c, parent in enumerate(skin.parents) if parent == k]
        nodes.append({"name": name, **({"children": children} if children else {})})
        for path, values in moved.items():
            nodes[-1][path] = values[0].tolist()
            if path == "scale" and np.all(np.abs(values - 1) < _SCALED):
                continue
            kind = "VEC4" if path == "rotation" else "VEC3"
            samplers.append({"input": times, "output": out.accessor(values[1:], _FLOAT, kind)})
            channels.append({"sampler": len(samplers) - 1, "target": {"node": 1 + k, "path": path}})
    roots = [1 + k for k, parent in enumerate(skin.parents) if parent < 0]
    return out.file(
        {
            "scenes": [{"nodes": [0, *roots]}],
            "nodes": nodes,
            "meshes": [{"primitives": [{"attributes": attributes, "indices": corners}]}],
            "skins": [
                {
                    "joints": list(range(1, 1 + len(skin.bones))),
                    "inverseBindMatrices": out.accessor(binds, _FLOAT, "MAT4"),
                }
            ],
            "animations": [{"name": "action", "samplers": samplers, "channels": channels}],
        }
    )


def _parts(matrices: np.ndarray) -> dict[str, np.ndarray]:
    """Translations, rotations (x, y, z, w) and scales of matrices; rotations one after another go the short way."""
    places, turns, sizes = [], [], []
    for matrix in matrices:
        place, turn, size = Matrix(matrix.tolist()).decompose()
        if turns and turn.dot(turns[-1]) < 0:
            turn.negate()
        places.append(place)
        turns.append(turn)
        sizes.append(size)
    rotations = np.array([(q.x, q.y, q.z, q.w) for q in turns])
    return {"translation": np.array(places), "rotation": rotations, "scale": np.array(sizes)}


class _Writer:
    """One buffer with its accessors."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._views: list[dict[str, int]] = []
        self._accessors: list[dict[str, Any]] = []

    def accessor(self, values: np.ndarray, kind: int, shape: str, *, bounds: bool = False) -> int:
        """Appends numbers, one row an element; answers the accessor's number."""
        rows = np.ascontiguousarray(values, {_FLOAT: "<f4", _SHORT: "<u2", _INT: "<u4"}[kind])
        data = rows.tobytes()
        self._views.append({"buffer": 0, "byteOffset": len(self._data), "byteLength": len(data)})
        self._data += data + bytes(-len(data) % 4)
        entry: dict[str, Any] = {
            "bufferView": len(self._views) - 1,
            "componentType": kind,
            "count": len(rows),
            "type": shape,
        }
        if bounds:
            entry |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        self._accessors.append(entry)
        return len(self._accessors) - 1

    def file(self, document: dict[str, Any]) -> bytes:
        """The GLB."""
        whole = {
            "asset": {"version": "2.0"},
            "scene": 0,
            **document,
            "buffers": [{"byteLength": len(self._data)}],
            "bufferViews": self._views,
            "accessors": self._accessors,
        }
        text = json.dumps(whole).encode()
        text += b" " * (-len(text) % 4)
        head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(self._data), len(text), 0x4E4F534A)
        return head + text + struct.pack("<II", len(self._data), 0x004E4942) + bytes(self._data)
