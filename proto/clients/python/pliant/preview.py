"""Previews: a session's shape as a small picture, for notebooks.

Nothing but numpy: the nearest of the triangles that cover the middle of a pixel is shaded by the light from the eye.
"""

from __future__ import annotations

import base64
import html
import json
import struct
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

from .v1 import pliant_pb2 as pb

#: Width and height of a picture, in pixels.
SIZE = (320, 240)
#: Degrees around the model from its front, and above the horizon: a little from the right and from above.
VIEW = (24.228, 14.326)
#: Pixels of the boxes around all triangles together, and triangles, above which triangles are left out: a preview is to come at once. Of a
#: larger picture, pixels a pixel of it.
_MOST_POINTS = 2_000_000
_MOST_POINTS_A_PIXEL = 6
_MOST_TRIANGLES = 500_000
#: Red, green and blue of what is lit in full, and of what is not there.
_CLAY = np.array([190.0, 198.0, 208.0])
_EMPTY = 255

#: How far outside of a triangle, as a share of its edges, a pixel still belongs to it, so that neighbours leave no gap.
_EDGE = 1e-9

_Doubles = npt.NDArray[np.float64]
_Whole = npt.NDArray[np.int64]


def surface_format(opened: str) -> str:
    """The format in which the server rewrites the triangles of such a model: a PLY would come back in its own form."""
    return "glb" if opened in ("ply", "splat", "spz") else "ply"


def triangles_of(file: bytes) -> tuple[_Doubles, npt.NDArray[np.int64]]:
    """Vertices and triangles of a binary PLY or a GLB as the server rewrites it."""
    return _of_glb(file) if file[:4] == b"glTF" else _of_ply(file)


def _of_glb(glb: bytes) -> tuple[_Doubles, npt.NDArray[np.int64]]:
    """Of a GLB with tightly packed numbers in one buffer, and nodes that move their meshes at most."""
    length = int.from_bytes(glb[12:16], "little")
    document, binary = json.loads(glb[20 : 20 + length]), glb[28 + length :]

    def read(accessor: int, width: int) -> npt.NDArray[Any]:
        told = document["accessors"][accessor]
        first = document["bufferViews"][told["bufferView"]].get("byteOffset", 0) + told.get("byteOffset", 0)
        kind = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[told["componentType"]]
        return np.frombuffer(binary, kind, told["count"] * width, first)

    places = {node["mesh"]: node.get("translation", [0, 0, 0]) for node in document.get("nodes", []) if "mesh" in node}
    points, triangles, rows = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], 0
    for number, mesh in enumerate(document["meshes"]):
        for primitive in mesh["primitives"]:
            own = read(primitive["attributes"]["POSITION"], 3).reshape(-1, 3)
            triangles.append(read(primitive["indices"], 1).reshape(-1, 3).astype(np.int64) + rows)
            points.append(own.astype(np.float64) + np.asarray(places.get(number, [0, 0, 0]), np.float64))
            rows += len(own)
    return np.concatenate(points), np.concatenate(triangles)


def _of_ply(ply: bytes) -> tuple[_Doubles, npt.NDArray[np.int64]]:
    """Of a binary PLY: numbers of 4 or 8 bytes, then lists of corners."""
    head, _, body = ply.partition(b"end_header\n")
    widths = {"float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8", "uchar": "u1", "uint8": "u1", "uint": "<u4"}
    columns: list[tuple[str, str]] = []
    counts: dict[str, int] = {}
    for words in (line.split() for line in head.decode("ascii").splitlines()):
        if words[:1] == ["element"]:
            counts[words[1]] = int(words[2])
        elif words[:1] == ["property"] and words[1] != "list" and "face" not in counts:
            columns.append((words[2], widths[words[1]]))
    rows = np.frombuffer(body, np.dtype(columns), counts["vertex"])
    faces = np.frombuffer(body, np.dtype([("count", "u1"), ("corners", "<u4", (3,))]), counts["face"], rows.nbytes)
    return np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=1), faces["corners"].astype(np.int64)


def picture(
    points: _Doubles, triangles: npt.NDArray[np.int64], size: tuple[int, int] = SIZE, view: tuple[float, float] = VIEW
) -> bytes:
    """A PNG of a surface seen from such degrees around it and above the horizon; on white."""
    width, height = size
    pixels = np.full((height, width, 3), _EMPTY, np.uint8)
    if not len(triangles) or not np.all(np.isfinite(points)):
        return png(pixels)
    triangles = triangles[:: -(-len(triangles) // _MOST_TRIANGLES)]
    seen = points @ _view(*np.radians(view)).T
    low, high = seen[triangles].reshape(-1, 3).min(axis=0), seen[triangles].reshape(-1, 3).max(axis=0)
    extent = np.maximum(high - low, 1e-300)
    scale = 0.92 * min(width / extent[0], height / extent[1])
    corners = ((seen - (low + high) / 2) * scale)[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    # Lit from the eye, and from both sides: open surfaces have no inside.
    light = np.abs(normals[:, 2]) / np.maximum(lengths, 1e-300)
    corners = corners * (1, -1, 1) + ((width - 1) / 2, (height - 1) / 2, 0)
    pixel, depth, which = _covered(corners, size)
    if not len(pixel):
        return png(pixels)
    order = np.lexsort((which, depth, pixel))
    last = np.append(np.diff(pixel[order]) != 0, True)
    front = order[last]
    shade = 0.25 + 0.75 * light[which[front]]
    pixels.reshape(-1, 3)[pixel[front]] = np.round(shade[:, None] * _CLAY).astype(np.uint8)
    return png(pixels)


def _view(around: float, above: float) -> _Doubles:
    """Rows: what lies to the right, up, and towards the eye."""
    eye = np.array([np.sin(around) * np.cos(above), np.sin(above), np.cos(around) * np.cos(above)])
    right = np.array([np.cos(around), 0.0, -np.sin(around)])
    return np.stack([right, np.cross(eye, right), eye])


def _covered(corners: _Doubles, size: tuple[int, int]) -> tuple[_Whole, _Doubles, _Whole]:
    """The pixels whose middles triangles cover, how near each is there, and the triangle. Corners are in pixels, to the
    right and down from the middle of the first."""
    width, height = size
    low = np.clip(np.ceil(corners[:, :, :2].min(axis=1)), 0, (width, height)).astype(np.int64)
    high = np.clip(np.floor(corners[:, :, :2].max(axis=1)), -1, (width - 1, height - 1)).astype(np.int64)
    boxes = np.maximum(high - low + 1, 0)
    counts = boxes.prod(axis=1)
    most = max(_MOST_POINTS, _MOST_POINTS_A_PIXEL * width * height)
    if counts.sum() > most:
        counts[np.arange(len(counts)) % -(-int(counts.sum()) // most) != 0] = 0
    which = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    place = low[which] + np.stack([within % boxes[which, 0], within // boxes[which, 0]], axis=1)
    # How far each is along two edges.
    first, *edges = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    (ax, ay, az), (bx, by, bz) = (edge[which].T for edge in edges)
    x, y = (place - first[which, :2]).T
    area = ax * by - ay * bx
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (x * by - y * bx) / area, (ax * y - ay * x) / area
        inside = (a >= -_EDGE) & (b >= -_EDGE) & (a + b <= 1 + _EDGE)
        depth = (first[which, 2] + a * az + b * bz)[inside]
    pixel = place[inside] @ (1, width)
    return pixel, depth, which[inside]


def png(pixels: npt.NDArray[np.uint8]) -> bytes:
    """Rows of red, green and blue as a PNG."""
    height, width, _ = pixels.shape
    rows = np.zeros((height, 1 + width * 3), np.uint8)  # every row begins with its filter: none
    rows[:, 1:] = pixels.reshape(height, -1)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(rows.tobytes(), 6))
        + chunk(b"IEND", b"")
    )


def card(info: pb.Session, handles: list[str], image: bytes | None) -> str:
    """What a notebook shows of a session: its facts, beside its picture where there is one."""
    facts: list[tuple[str, Any]] = [
        ("model", f"{info.model.vertices:,} vertices, {info.model.triangles:,} triangles"),
        ("handles", ", ".join(handles) or "none"),
        ("revision", info.revision),
        ("session", info.id),
    ]
    rows = "".join(f"<tr><th>{name}</th><td>{html.escape(str(value))}</td></tr>" for name, value in facts)
    shown = "" if image is None else f'<img alt="the shape" src="data:image/png;base64,{base64.b64encode(image).decode()}">'
    title = html.escape(info.label or "pliant session")
    return f"<div><strong>{title}</strong><div>{shown}<table>{rows}</table></div></div>"
