"""The folder of a batch's results: a folder for each job, with its files and a record of what they were made of.

Every file is written beside its place and renamed. The record goes first and comes last, so that it vouches for nothing that is
not there: a run that is broken off anywhere leaves a job either finished or to be done.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from google.protobuf import json_format

from ..v1 import pliant_pb2 as pb
from .results import JobResult

RECORD = "result.json"
#: Bytes of the longest record that is read.
_RECORD_BYTES = 64 << 20


@dataclass(frozen=True)
class ResultFolder:
    """Where results are kept."""

    path: Path

    def finished(self, name: str, key: str) -> JobResult | None:
        """The result of an earlier run, where it was made of the same and every byte of it is there."""
        folder = self.path / name
        try:
            if (folder / RECORD).stat().st_size > _RECORD_BYTES:
                return None
            record: Any = json.loads((folder / RECORD).read_text())
            if record["key"] != key or not record["files"]:
                return None
            for file, digest in record["files"].items():
                if _digest(_inside(folder, file).read_bytes()) != digest:
                    return None
            quality = record["quality"]
            return JobResult(
                name,
                key,
                str(record["digest"]),
                None if quality is None else json_format.ParseDict(quality, pb.Quality()),
                tuple(map(str, record["unmet"])),
                tuple(map(str, record["unchecked"])),
                tuple(json_format.ParseDict(told, pb.Report.Passenger()) for told in record["passengers"]),
                tuple(folder / file for file in record["files"]),
                resumed=True,
            )
        except (OSError, ValueError, LookupError, TypeError, AttributeError, json_format.ParseError):
            # Whatever is wrong with it, it is no result: the job is run again.
            return None

    def keep(self, result: JobResult, files: Mapping[str, bytes]) -> tuple[Path, ...]:
        """Writes a result; answers the paths of its files."""
        folder = self.path / result.name
        folder.mkdir(parents=True, exist_ok=True)
        record = {
            "name": result.name,
            "key": result.key,
            "digest": result.digest,
            "quality": None if result.quality is None else json_format.MessageToDict(result.quality),
            "unmet": result.unmet,
            "unchecked": result.unchecked,
            "passengers": [json_format.MessageToDict(told) for told in result.passengers],
            "files": {name: _digest(data) for name, data in files.items()},
        }
        paths = {name: _inside(folder, name) for name in files}
        (folder / RECORD).unlink(missing_ok=True)
        for name, data in files.items():
            _write(paths[name], data)
        _write(folder / RECORD, (json.dumps(record, indent=1) + "\n").encode())
        return tuple(folder / name for name in files)


def _inside(folder: Path, name: str) -> Path:
    path = PurePosixPath(name)
    if (
        path.is_absolute()
        or ".." in path.parts
        or name in ("", RECORD)
        or not (folder / path).resolve().is_relative_to(folder.resolve())
    ):
        raise ValueError(f"the result's file {name!r} would lie outside {folder}")
    return folder / path


def _digest(data: bytes) -> str:
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, beside = tempfile.mkstemp(prefix=".", suffix=".part", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    except BaseException:
        Path(beside).unlink(missing_ok=True)
        raise
