"""Nodes of ComfyUI that pose a mesh through a pliant server: open it, name handles, pose them, draw and export the result.

What goes from node to node is a `Posed`: the model with handles and poses as plain values. ComfyUI keeps it while its inputs stay, so a node
never changes what it was given. The solve happens where its result is needed, and does not depend on what was solved before.
"""

from __future__ import annotations

import hashlib
import io
import json
import weakref
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import pliant

AXES = ("x", "y", "z")
KINDS = ("sphere", *(f"{axis} {side}" for axis in AXES for side in ("below", "above")), "part", "json")
FORMATS = ("glb", "gltf", "obj", "ply", "off", "stl", "3mf")


def number(default: float, tooltip: str, low: float = -1000.0, high: float = 1000.0) -> tuple[str, dict[str, Any]]:
    """An input of ComfyUI that is a number."""
    return ("FLOAT", {"default": default, "min": low, "max": high, "step": 0.01, "tooltip": tooltip})


def folder(kind: str) -> Path:
    """ComfyUI's folder for files that come in or go out; the working directory outside of ComfyUI."""
    try:
        import folder_paths
    except ImportError:
        return Path.cwd()
    return Path(folder_paths.get_input_directory() if kind == "input" else folder_paths.get_output_directory())


class Opened:
    """A model on a server, with its session in the shape that was asked for last."""

    def __init__(self, source: Any, server: str) -> None:
        self._source, self._server = source, server
        self._session: pliant.Session | None = None
        #: The shape of the session; None: the rest pose, without handles.
        self._shown: Posed | None = None
        rest = self._open().positions()
        self.low, self.size = rest.min(axis=0).astype(float), np.ptp(rest, axis=0).astype(float)

    def _open(self) -> pliant.Session:
        """The session, which is opened again where it has expired or its server was started again."""
        if self._session is not None:
            try:
                self._session.refresh()
            except (LookupError, ConnectionError, pliant.LocalServerError):
                self.close()
        if self._session is None:
            self._session = pliant.open(self._source, server=self._server or None)
            self._shown = None
            # When ComfyUI lets go of the model. At its own end sessions end with their server, or expire.
            self._end = weakref.finalize(self, self._session.close)
            self._end.atexit = False
        return self._session

    def shaped(self, posed: Posed) -> pliant.Session:
        """The session in such a shape, made from the rest pose."""
        session = self._open()
        if self._shown == posed:
            return session
        try:
            if self._shown is not None:
                session.undo()
                session.undo()
                self._shown = None
            if posed.handles:
                for name, settings in posed.handles.items():
                    session.handle(name, **settings)
                session.solve(posed.poses)
                self._shown = posed
        except BaseException:
            # How far it came is not known.
            self.close()
            raise
        return session

    def close(self) -> None:
        """Frees what the server holds; a later use opens the model again."""
        if self._session is not None:
            self._session = None
            self._end()


@dataclass(frozen=True)
class Posed:
    """A model, its handles, and where they are."""

    model: Opened
    handles: dict[str, dict[str, Any]] = field(default_factory=dict)
    poses: dict[str, dict[str, Any]] = field(default_factory=dict)

    def session(self) -> pliant.Session:
        """The model's session in this shape; until another shape of the model is asked for."""
        return self.model.shaped(self)


class OpenMesh:
    """Opens a model file, or a mesh that another node made."""

    RETURN_TYPES = ("PLIANT",)
    FUNCTION = "open"
    CATEGORY = "pliant"

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Any]:
        path = {"default": "", "tooltip": "glb, gltf, obj, ply, off, stl, 3mf or fbx: a path, or a name in ComfyUI's input folder"}
        server = {"default": "", "tooltip": "http://HOST:PORT; empty: PLIANT_SERVER, or a server that is started on this machine"}
        return {"required": {"path": ("STRING", path)}, "optional": {"server": ("STRING", server), "mesh": ("MESH",)}}

    @classmethod
    def IS_CHANGED(cls, path: str, **_: Any) -> str:
        file = folder("input") / path
        return hashlib.sha256(file.read_bytes()).hexdigest() if path and file.is_file() else ""

    def open(self, path: str, server: str = "", mesh: Any = None) -> tuple[Posed]:
        if (mesh is None) == (path == ""):
            raise ValueError("Open mesh: a path or a mesh is needed, and only one of them")
        source: Any = folder("input") / path
        if mesh is not None:
            source = tuple(np.asarray(batch[0].cpu() if hasattr(batch, "cpu") else batch[0]) for batch in (mesh.vertices, mesh.faces))
        return (Posed(Opened(source, server)),)


class NameHandle:
    """Names a region of the rest pose: it is moved by Pose handle, and held where it is not."""

    RETURN_TYPES = ("PLIANT",)
    FUNCTION = "add"
    CATEGORY = "pliant"

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Any]:
        places = {axis: number(0.5, f"{axis} in the model's box: 0 to 1", -10.0, 10.0) for axis in AXES}
        region = {"default": "", "multiline": True, "tooltip": 'for the kind json, such as {"capsule": {"from": [0, 0, 0], "to": [0, 1, 0], "radius": 0.1}}'}
        required = {"model": ("PLIANT",), "name": ("STRING", {"default": "head"}), "kind": (list(KINDS), {"default": "sphere"}), **places}
        required["radius"] = number(0.2, "of the sphere, as a share of the longest side of the box", 0.0, 10.0)
        stiffness = number(0.0, "0: hard; above, how strongly a soft handle pulls", 0.0, 1e6)
        part = ("INT", {"default": 0, "min": 0, "max": 1_000_000, "tooltip": "for the kind part: which connected part"})
        return {"required": required, "optional": {"stiffness": stiffness, "part": part, "region": ("STRING", region)}}

    def add(
        self, model: Posed, name: str, kind: str, stiffness: float = 0.0, part: int = 0, region: str = "", **numbers: float
    ) -> tuple[Posed]:
        place = model.model.low + np.array([numbers[axis] for axis in AXES]) * model.model.size
        settings: dict[str, Any]
        if kind == "sphere":
            settings = {"sphere": (place.tolist(), numbers["radius"] * float(model.model.size.max()))}
        elif kind == "part":
            settings = {"component": part}
        elif kind == "json":
            settings = json.loads(region)
        else:
            axis, side = kind.split()
            normal = np.eye(3)[AXES.index(axis)] * (1 if side == "above" else -1)
            settings = {"half_space": (normal.tolist(), float(normal @ place))}
        if stiffness > 0:
            settings["stiffness"] = stiffness
        return (replace(model, handles={**model.handles, name: settings}),)


class PoseHandle:
    """Moves, turns and scales a handle. It says where the handle is, not how much further it goes."""

    RETURN_TYPES = ("PLIANT",)
    FUNCTION = "pose"
    CATEGORY = "pliant"

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Any]:
        moves = {f"move_{axis}": number(0.0, "as a share of the longest side of the box", -10.0, 10.0) for axis in AXES}
        turns = {f"turn_{axis}": number(0.0, "degrees: one axis times one angle, about the handle's joint", -3600.0, 3600.0) for axis in AXES}
        free = ("BOOLEAN", {"default": False, "tooltip": "what is moved turns as the rest of the model asks for"})
        required = {"model": ("PLIANT",), "name": ("STRING", {"default": "head"}), **moves, **turns, "scale": number(1.0, "1: as it is", 0.01, 100.0)}
        return {"required": required, "optional": {"free_rotation": free}}

    def pose(self, model: Posed, name: str, scale: float, free_rotation: bool = False, **numbers: float) -> tuple[Posed]:
        if name not in model.handles:
            raise ValueError(f"Pose handle: there is no handle {name!r} before this node; there are {', '.join(model.handles) or 'none'}")
        move = np.array([numbers[f"move_{axis}"] for axis in AXES]) * model.model.size.max()
        pose = {"translation": move.tolist(), "rotation_degrees": [numbers[f"turn_{axis}"] for axis in AXES], "scale": scale}
        return (replace(model, poses={**model.poses, name: {**pose, "free_rotation": free_rotation}}),)


class RenderMesh:
    """Draws the posed model: clay on white, for a look, or to guide what draws on."""

    RETURN_TYPES = ("IMAGE",)
    FUNCTION = "render"
    CATEGORY = "pliant"

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Any]:
        size = {name: ("INT", {"default": 512, "min": 16, "max": 1024, "step": 8}) for name in ("width", "height")}
        angles = {"around": number(24.0, "degrees around the model; 0: from the front", -360.0, 360.0), "above": number(14.0, "degrees", -89.0, 89.0)}
        return {"required": {"model": ("PLIANT",), **size, **angles}}

    def render(self, model: Posed, width: int, height: int, around: float, above: float) -> tuple[Any]:
        import torch
        from PIL import Image

        png = model.session().preview(width, height, (around, above))
        pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), np.float32) / 255
        return (torch.from_numpy(pixels)[None],)


class ExportMesh:
    """Solves the pose to the tolerance and writes the model to ComfyUI's output folder; a file of that name is replaced."""

    RETURN_TYPES = ("STRING",)
    RETURN_NAMES = ("path",)
    FUNCTION = "export"
    CATEGORY = "pliant"
    OUTPUT_NODE = True

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Any]:
        name = {"default": "pliant/posed", "tooltip": "a name in ComfyUI's output folder, without the extension"}
        return {"required": {"model": ("PLIANT",), "name": ("STRING", name), "format": (list(FORMATS), {"default": "glb"})}}

    def export(self, model: Posed, name: str, format: str) -> dict[str, Any]:
        output = folder("output").resolve()
        path = (output / f"{name}.{format}").resolve()
        if not path.is_relative_to(output):
            raise ValueError(f"Commit and export: {name!r} is outside of {output}; a name inside is allowed")
        model.session().export(path, force=True)
        return {"ui": {"text": [str(path)]}, "result": (str(path),)}


TITLES = {
    OpenMesh: "Open mesh",
    NameHandle: "Name handle",
    PoseHandle: "Pose handle",
    RenderMesh: "Render mesh",
    ExportMesh: "Commit and export",
}
NODE_CLASS_MAPPINGS = {f"Pliant{node.__name__}": node for node in TITLES}
NODE_DISPLAY_NAME_MAPPINGS = {f"Pliant{node.__name__}": f"{title} (pliant)" for node, title in TITLES.items()}
for node in TITLES:
    node.DESCRIPTION = node.__doc__  # what ComfyUI shows as its help
