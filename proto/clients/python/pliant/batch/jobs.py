"""Jobs, and how they travel to a worker: as bytes, so that workers need none of the caller's files."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Union

from google.protobuf import json_format

from ..model import Model, read
from ..values import seen, text
from ..v1 import pliant_pb2 as pb
from .riders import refusal

#: What a job's name looks like: it names a folder as well, on any system.
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,119}")
#: Formats that a result may have.
FORMATS = ("glb", "vrm", "gltf", "obj", "ply", "off", "stl", "3mf", "splat", "spz")
#: Bytes of the largest file that a job may name, and of the largest job.
_LARGEST = 1 << 30


@dataclass(frozen=True)
class Job:
    """A model and what is done with it: what ``pliant deform MODEL --job JOB`` takes."""

    #: What results and errors call it, and the folder of its results: letters, digits, ``.``, ``_`` and ``-``.
    name: str
    #: What :func:`pliant.open` takes: a path, bytes, arrays, a mesh.
    model: Model
    #: The path of a job file, or what one holds: a dict, or a ``pb.Job``. A file may name models that lie beside it.
    job: Union[str, os.PathLike[str], Mapping[str, Any], pb.Job]
    #: Files that the model refers to, by URI; those of a path are found beside it.
    companions: Mapping[str, bytes] | None = None
    #: What the result is written as; absent, the model's own format, and glb for fbx.
    format: str | None = None


class Unready(Exception):
    """A job that cannot be sent: ``where`` says which part of it is wrong."""

    def __init__(self, where: str, problem: BaseException | str) -> None:
        super().__init__(str(problem))
        self.where = where
        self.missing = isinstance(problem, FileNotFoundError)


@dataclass(frozen=True)
class Task:
    """A job as it travels."""

    name: str
    #: Digest of model, job, format and version: what is the same has the same result.
    key: str
    version: str
    main: bytes
    companions: dict[str, bytes]
    model_format: str
    label: str
    #: A ``pb.Job``.
    job: bytes
    format: str


def named(jobs: Iterable[Job]) -> list[Job]:
    """The jobs, when every one has a name of its own."""
    if isinstance(jobs, (str, bytes, Mapping)) or not isinstance(jobs, Iterable):
        raise TypeError(f"jobs: {seen(jobs)}, a list or an iterator of pliant.batch.Job is allowed")
    every: list[Job] = []
    places: dict[str, int] = {}
    for k, job in enumerate(jobs):
        if not isinstance(job, Job):
            raise TypeError(f"jobs[{k}]: {seen(job)}, a pliant.batch.Job is allowed")
        if not _NAME.fullmatch(text(f"jobs[{k}].name", job.name)) or job.name.endswith("."):
            allowed = (
                "1 to 120 letters, digits, '.', '_' and '-' that begin with none of '.' and '-' and do not end with '.'"
            )
            raise ValueError(f"jobs[{k}].name: {seen(job.name)}, {allowed} are allowed")
        # Names that differ by case alone are one folder on some systems.
        first = places.setdefault(job.name.casefold(), k)
        if first != k:
            raise ValueError(f"jobs[{k}].name: {job.name!r} is as jobs[{first}], a name of its own is allowed")
        if job.format is not None and job.format not in FORMATS:
            raise ValueError(f"jobs[{k}].format: {seen(job.format)}, one of {', '.join(FORMATS)} is allowed")
        every.append(job)
    return every


def task(job: Job, version: str) -> Task:
    """Reads a job's files."""
    try:
        upload = read(job.model, job.companions)
    except (OSError, ValueError, TypeError) as problem:
        raise Unready("model", problem) from None
    message = _message(job)
    own = upload.format or ("glb" if upload.main[:4] == b"glTF" else "ply" if upload.main[:3] == b"ply" else "")
    format = job.format or ("glb" if own == "fbx" else own)
    if not format:
        untold = f"the model's bytes do not show which format to write; one of {', '.join(FORMATS)} is allowed"
        raise Unready("format", untold)
    refused = refusal(message, format) or _dropped(message)
    if refused is not None:
        raise Unready(f"{_place(job)}: {refused[0]}", refused[1])
    bytes_of_job = message.SerializeToString(deterministic=True)
    said = [version, format, own]
    parts = [b"pliant batch 1", *(part.encode() for part in said), upload.main, bytes_of_job]
    for uri in sorted(upload.companions):
        parts += [uri.encode(errors="surrogateescape"), upload.companions[uri]]
    return Task(
        job.name,
        _digest(parts),
        version,
        upload.main,
        upload.companions,
        upload.format,
        upload.label,
        bytes_of_job,
        format,
    )


def _dropped(message: pb.Job) -> tuple[str, str] | None:
    """A pose that a handle comes with and that the first step would drop, as ``pliant deform`` refuses it."""
    if not message.steps or message.steps[0].WhichOneof("step") != "edit":
        return None
    edit = message.steps[0].edit
    for k, handle in enumerate(message.handles):
        moves = handle.HasField("pose") and handle.pose != pb.HandlePose()
        if moves and edit.on == pb.EditRequest.On.CURRENT and not edit.subdivide.auto:
            return f"handles[{k}].pose", "is given, but the first step is an edit, which would drop it"
    return None


def _digest(parts: Iterable[bytes]) -> str:
    total = hashlib.sha256()
    for part in parts:
        total.update(len(part).to_bytes(8, "little"))
        total.update(part)
    return f"sha256:{total.hexdigest()}"


def _message(job: Job) -> pb.Job:
    folder: Path | None = None
    message = pb.Job()
    try:
        if isinstance(job.job, pb.Job):
            message.CopyFrom(job.job)
        elif isinstance(job.job, Mapping):
            json_format.ParseDict(dict(job.job), message)
        elif isinstance(job.job, (str, os.PathLike)):
            folder = Path(job.job).parent
            json_format.Parse(_read(Path(job.job)).decode(), message)
        else:
            raise TypeError(f"{seen(job.job)}, the path of a job file, a dict or a pb.Job is allowed")
    except json_format.ParseError as wrong:
        raise Unready(_place(job), " ".join(str(wrong).split())) from None
    except (OSError, ValueError, TypeError) as wrong:
        raise Unready(_place(job), wrong) from None
    for place, source in _named_models(message):
        try:
            name = source.file
            source.model = _beside(folder, name)
        except (OSError, ValueError) as wrong:
            raise Unready(f"{_place(job)}: {place}", wrong) from None
        source.format = source.format or Path(name).suffix.lstrip(".").lower()
    return message


def _place(job: Job) -> str:
    return f"job {os.fspath(job.job)}" if isinstance(job.job, (str, os.PathLike)) else "job"


def _named_models(message: pb.Job) -> Iterator[tuple[str, Any]]:
    """What of a job names a file."""
    for k, step in enumerate(message.steps):
        if step.edit.merge.WhichOneof("source") == "file":
            yield f"steps[{k}].edit.merge.file", step.edit.merge
        if step.edit.wrap.WhichOneof("target") == "file":
            yield f"steps[{k}].edit.wrap.file", step.edit.wrap
    for k, passenger in enumerate(message.create.passengers):
        if passenger.file.WhichOneof("source") == "file":
            yield f"create.passengers[{k}].file.file", passenger.file


def _beside(folder: Path | None, name: str) -> bytes:
    if folder is None:
        raise ValueError(
            f"{name!r} is named by a job that is not a file; the model's bytes, or the path of a job file, are allowed"
        )
    path = (folder / name).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise ValueError(f"{name!r} lies outside {folder.resolve()}; files below the job's folder are allowed")
    return _read(path)


def _read(path: Path) -> bytes:
    if path.exists() and not path.is_file():
        raise ValueError(f"{path} is not a regular file")
    size = path.stat().st_size
    if size > _LARGEST:
        raise ValueError(f"{path} has {size} bytes, at most {_LARGEST} are allowed")
    return path.read_bytes()
