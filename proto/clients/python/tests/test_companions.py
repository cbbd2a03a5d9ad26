"""The files that belong to a .gltf: they travel with it, and come back as they were."""

from __future__ import annotations

import asyncio
import json
import struct
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from conftest import bar

import pliant
import pliant.aio

PICTURE = b"\x89PNG\r\n\x1a\n not a picture that anybody looks at"


def bar_gltf(folder: Path) -> Path:
    """A bar as a .gltf with a buffer and two pictures outside, one of them in a folder of its own."""
    vertices, faces = bar()
    points, indices = vertices.astype("<f4"), faces.astype("<u2")
    (folder / "textures").mkdir(parents=True)
    (folder / "the bar.bin").write_bytes(points.tobytes() + indices.tobytes())
    (folder / "textures" / "base colour.png").write_bytes(PICTURE)
    (folder / "normal.jpg").write_bytes(b"\xff\xd8\xff" + PICTURE)
    size = points.nbytes
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "normalTexture": {"index": 1}}],
        "textures": [{"source": 0}, {"source": 1}],
        "images": [{"uri": "textures/base%20colour.png"}, {"uri": "normal.jpg"}],
        "buffers": [{"byteLength": size + indices.nbytes, "uri": "the%20bar.bin"}],
        "bufferViews": [
            {"buffer": 0, "byteLength": size},
            {"buffer": 0, "byteOffset": size, "byteLength": indices.nbytes},
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": len(points),
                "type": "VEC3",
                "min": points.min(0).tolist(),
                "max": points.max(0).tolist(),
            },
            {"bufferView": 1, "componentType": 5123, "count": indices.size, "type": "SCALAR"},
        ],
    }
    path = folder / "bar.gltf"
    path.write_text(json.dumps(document))
    return path


def pictures_of(document: dict[str, list[dict[str, int | str]]], folder: Path, chunk: bytes) -> list[bytes]:
    """The bytes of every image of a document, from beside it or out of a GLB's binary chunk."""
    found = []
    for image in document.get("images", []):
        if "uri" in image:
            found.append((folder / unquote(str(image["uri"]))).read_bytes())
        else:
            view = document["bufferViews"][int(image["bufferView"])]
            first = int(view.get("byteOffset", 0))
            found.append(chunk[first : first + int(view["byteLength"])])
    return found


def glb_parts(path: Path) -> tuple[dict[str, list[dict[str, int | str]]], bytes]:
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def bend(session: pliant.Session) -> None:
    points = session.positions()
    low, high = points.min(0), points.max(0)
    axis = int(np.argmax(high - low))
    normal = np.eye(3)[axis]
    third = (high - low)[axis] / 3
    along = points[:, axis]
    session.handle("low", vertices=along < low[axis] + third)
    session.handle("high", vertices=along > high[axis] - third)
    session.solve({"high": {"rotation_vector": 0.3 * np.roll(normal, 1)}})


def check(path: Path, folder: Path, server: pliant.LocalServer) -> None:
    before = pictures_of(json.loads(path.read_text()), path.parent, b"")
    assert before
    with pliant.open(path, server=server) as session:
        bend(session)
        written = session.export(folder / "deformed.gltf")
        assert len(written) > len(before)
        assert pictures_of(json.loads((folder / "deformed.gltf").read_text()), folder, b"") == before
        alone = folder / "alone"
        alone.mkdir()
        assert session.export(alone / "deformed.glb") == [alone / "deformed.glb"]
    document, chunk = glb_parts(alone / "deformed.glb")
    assert pictures_of(document, alone, chunk) == before
    assert all("uri" not in image and str(image["mimeType"]).startswith("image/") for image in document["images"])
    assert all("uri" not in buffer for buffer in document["buffers"])


def test_buffers_and_pictures_travel_and_come_back(server: pliant.LocalServer, tmp_path: Path) -> None:
    check(bar_gltf(tmp_path / "model"), tmp_path, server)


def test_they_travel_without_waiting_too(server: pliant.LocalServer, tmp_path: Path) -> None:
    path = bar_gltf(tmp_path / "model")

    async def there_and_back() -> list[Path]:
        async with pliant.aio.open(path, server=server) as session:
            return await session.export(tmp_path / "out" / "same.gltf")

    written = asyncio.run(there_and_back())
    assert len(written) == 4
    for file in written:
        name = "bar.gltf" if file.name == "same.gltf" else str(file.relative_to(tmp_path / "out"))
        assert file.read_bytes() == (path.parent / name).read_bytes()


def test_a_missing_picture_is_told_and_a_missing_buffer_refused(server: pliant.LocalServer, tmp_path: Path) -> None:
    path = bar_gltf(tmp_path)
    (tmp_path / "normal.jpg").unlink()
    with pliant.open(path, server=server) as session:
        told = [w for w in session.info.warnings if w.code == "image-missing"]
        assert len(told) == 1 and "normal.jpg" in told[0].message and told[0].where == "images/1"
    (tmp_path / "the bar.bin").unlink()
    with pytest.raises(pliant.InvalidArgument, match=r"the bar\.bin"):
        pliant.open(path, server=server)


@pytest.mark.parametrize("name", ["WaterBottle", "BoomBox", "AnimatedCube"])
def test_real_models_keep_every_picture(name: str, server: pliant.LocalServer, data: Path, tmp_path: Path) -> None:
    check(data / f"gltf/{name}_separate/{name}.gltf", tmp_path, server)
