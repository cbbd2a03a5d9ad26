"""Models: what can be opened, as the bytes that are uploaded."""

from __future__ import annotations

import json
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Protocol, TypeAlias, Union, runtime_checkable
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from .progress import Progress
from .values import array, seen
from .v1 import pliant_pb2 as pb

#: Bytes of one piece of an upload, where the server takes messages of that size.
_PIECE = 1 << 20
#: Bytes that a message needs beside its piece.
_FRAMING = 64
#: Bytes of the longest label that a server takes.
_LABEL_BYTES = 256
#: Characters of the longest name that a file may have anywhere.
_LONGEST_NAME = 4096


@runtime_checkable
class MeshLike(Protocol):
    """Anything with vertices and faces, such as a mesh of trimesh."""

    @property
    def vertices(self) -> Any:
        """(vertices, 3) numbers."""

    @property
    def faces(self) -> Any:
        """(faces, 3 or 4) indices."""


@runtime_checkable
class SceneLike(Protocol):
    """Several meshes with their places and materials, such as a scene of trimesh."""

    @property
    def geometry(self) -> Any:
        """The meshes."""

    def export(self, *, file_type: str) -> Any:
        """The bytes of a file."""


Model: TypeAlias = Union[str, "os.PathLike[str]", bytes, BinaryIO, "tuple[npt.ArrayLike, npt.ArrayLike]", MeshLike, SceneLike]


@dataclass
class Upload:
    """The bytes of a model and of the files that it refers to."""

    main: bytes
    companions: dict[str, bytes] = field(default_factory=dict)
    #: The format, where the bytes alone do not show it.
    format: str = ""
    #: What people call it: the name of its file.
    label: str = ""

    def requests(
        self, options: pb.CreateOptions, message_bytes: int, progress: Progress
    ) -> Iterator[pb.CreateSessionRequest]:
        """The messages of the upload, none larger than the server accepts; reports how many bytes went out."""
        size = max(1, min(_PIECE, message_bytes - _FRAMING))
        yield pb.CreateSessionRequest(options=options)
        done = 0
        total = len(self.main) + sum(map(len, self.companions.values()))
        for uri, data in [("", self.main), *self.companions.items()]:
            if uri:
                yield pb.CreateSessionRequest(companion=pb.Companion(uri=uri))
            for first in range(0, len(data), size):
                piece = data[first : first + size]
                yield pb.CreateSessionRequest(chunk=piece)
                done += len(piece)
                progress(done, total)


def read(model: Model, companions: Mapping[str, bytes] | None = None) -> Upload:
    """Reads whatever names or is a model.

    A path also reads the files that the model names, from beside it: buffers and images of a .gltf, the material
    libraries of an .obj and their pictures. Arrays become a PLY in which vertices keep their number.
    """
    if isinstance(model, (str, os.PathLike)):
        path = Path(model)
        upload = Upload(path.read_bytes(), format=path.suffix.lstrip(".").lower(), label=_label(path.name))
        if upload.format not in ("glb", "vrm", "gltf", "obj", "ply", "off", "stl", "3mf", "fbx", "splat", "spz"):
            upload.format = ""
        if companions is None:
            upload.companions = _beside(path, upload.main)
    elif isinstance(model, (bytes, bytearray, memoryview)):
        upload = Upload(bytes(model))
    elif isinstance(model, tuple):
        if len(model) != 2:
            raise ValueError(f"a model in {len(model)} arrays, (vertices, faces) is allowed")
        upload = Upload(ply(*model), format="ply")
    elif isinstance(model, MeshLike):
        upload = Upload(ply(model.vertices, model.faces), format="ply")
    elif isinstance(model, SceneLike):
        upload = Upload(bytes(model.export(file_type="glb")), format="glb")
    elif callable(getattr(model, "read", None)):
        upload = Upload(_content(model.read()))
    else:
        raise TypeError(
            f"model: {seen(model)}; a path, the bytes of a file, a file open for reading, (vertices, faces), "
            "a mesh with these attributes, or a trimesh scene is allowed"
        )
    if companions is not None:
        upload.companions = dict(companions)
    return upload


def _label(name: str) -> str:
    """A file's name as a label; nothing where it makes none."""
    return name if name.isprintable() and len(name.encode(errors="replace")) <= _LABEL_BYTES else ""


def _content(data: Any) -> bytes:
    if not isinstance(data, bytes):
        raise TypeError(f"model: the open file gives {type(data).__name__}, bytes are allowed: open it with 'rb'")
    return data


def _beside(path: Path, main: bytes) -> dict[str, bytes]:
    """The files that a model names and that lie beside it. What is missing is left to the server to complain about."""
    folder = path.parent.resolve()
    found: dict[str, bytes] = {}
    names = list(_named(main) if path.suffix.lower() != ".obj" else _libraries(main))
    for name in names:
        if len(name) > _LONGEST_NAME or "\0" in name:
            continue  # no file has that name, and asking for one fails or takes long
        named = (folder / name).resolve()
        # A model from elsewhere must not make us send files from outside its folder.
        if name not in found and named.is_relative_to(folder) and named.is_file():
            found[name] = named.read_bytes()
            if path.suffix.lower() == ".obj" and name.lower().endswith(".mtl"):
                names.extend(_pictures(found[name]))
    return found


def _named(main: bytes) -> Iterator[str]:
    """The relative names of buffers and images in a glTF or GLB; none in any other file."""
    if main[:4] == b"glTF":
        main = main[20 : 20 + int.from_bytes(main[12:16], "little")]
    elif not main.lstrip()[:1] == b"{":
        return
    try:
        document = json.loads(main)
        items = [item for key in ("buffers", "images") for item in document.get(key, [])]
        uris = [item["uri"] for item in items if isinstance(item.get("uri"), str)]
    except (ValueError, TypeError, AttributeError):
        return
    for uri in uris:
        # Names count from the folder of the model, with or without a leading "./".
        if not uri[:5].lower() == "data:" and (name := unquote(uri).removeprefix("./")):
            yield name


def _libraries(main: bytes) -> Iterator[str]:
    """The material libraries of an OBJ: all words of a line as one name, and each for itself."""
    for line in re.findall(rb"^[ \t]*mtllib[ \t]+([^\r\n]+)", main, re.MULTILINE):
        rest = line.decode("utf-8", "replace").strip()
        yield from dict.fromkeys(name.replace("\\", "/").removeprefix("./") for name in [rest, *rest.split()])


#: A picture's statement in a material library: its options, then the name of the file.
_PICTURE = re.compile(
    r"^[ \t]*(?:map_\w+|bump|disp|decal|refl|norm)[ \t]+"
    r"((?:-(?:[ost](?:[ \t]+[-+.\deE]+){1,3}|mm(?:[ \t]+[-+.\deE]+){1,2}|\w+[ \t]+\S+)[ \t]+)*)([^\r\n]+)",
    re.MULTILINE | re.IGNORECASE,
)


def _pictures(library: bytes) -> Iterator[str]:
    """The pictures that a material library names."""
    for _, name in _PICTURE.findall(library.decode("utf-8", "replace")):
        yield name.strip().replace("\\", "/").removeprefix("./")


def ply(vertices: npt.ArrayLike, faces: npt.ArrayLike) -> bytes:
    """A binary PLY of (n, 3) vertices and (m, corners) faces; numbers keep their precision."""
    points = array("vertices", vertices)
    corners = np.asarray(faces)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"vertices have shape {points.shape}, (vertices, 3) is allowed")
    if corners.ndim != 2 or not 3 <= corners.shape[1] <= 255 or not np.issubdtype(corners.dtype, np.integer):
        raise ValueError(f"faces are {corners.dtype} of shape {corners.shape}, (faces, 3) whole numbers are allowed")
    if corners.size and not 0 <= int(corners.min()) <= int(corners.max()) < len(points):
        raise ValueError(f"faces name vertices {corners.min()} to {corners.max()} of {len(points)}")
    single = points.dtype == np.float32
    name = "float" if single else "double"
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(points)}\nproperty {name} x\nproperty {name} y\nproperty {name} z\n"
        f"element face {len(corners)}\nproperty list uchar uint vertex_indices\nend_header\n"
    )
    rows = np.empty(len(corners), np.dtype([("count", "u1"), ("corners", "<u4", (corners.shape[1],))]))
    rows["count"] = corners.shape[1]
    rows["corners"] = corners
    return header.encode() + points.astype("<f4" if single else "<f8").tobytes() + rows.tobytes()


def warn_of(answers: Iterable[pb.Chunk | pb.CarryResponse]) -> None:
    """Issues what written files say of themselves as warnings of Python: what they do not hold, or what may not fit any more."""
    for told in (warning for answer in answers for warning in answer.warnings):
        place = f" ({told.where})" if told.where else ""
        warnings.warn(f"{told.code}: {told.message}{place}", UserWarning, stacklevel=2)


def joined(chunks: Iterable[pb.Chunk]) -> dict[str, bytes]:
    """An export's files by URI; "" is the main one."""
    files: dict[str, list[bytes]] = {}
    for chunk in chunks:
        files.setdefault(chunk.uri, []).append(chunk.data)
    return {uri: b"".join(pieces) for uri, pieces in files.items()}


def write(path: Path, files: Mapping[str, bytes], force: bool = False) -> list[Path]:
    """Writes an export: the main file under `path`, companions beside it. Answers the paths.

    They are of one kind: relative, or absolute, as `path` is. Before anything is written, a companion that would replace a
    file with other bytes is refused, unless `force` is set.
    """
    folder = path.parent.resolve()
    targets: list[tuple[Path, bytes]] = []
    for uri, data in files.items():
        # As the caller names the main file: relative where that is relative.
        target = path if uri == "" else path.parent / uri
        if uri and not target.resolve().is_relative_to(folder):
            raise ValueError(f"the model's companion {uri!r} would be written outside {folder}")
        if uri and not force and target.exists() and target.read_bytes() != data:
            raise FileExistsError(f"{target} is there and holds other bytes; force=True replaces it")
        targets.append((target, data))
    for target, data in targets:
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(data)
    return [target for target, _ in targets]
