"""Blend shapes, or another shape, that come to a session's model from another model."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Union

from . import model
from .edits import landmark
from .values import about, text
from .v1 import pliant_pb2 as pb

#: A file, or its bytes.
ModelLike = Union[str, "os.PathLike[str]", bytes]


@dataclass(frozen=True)
class Transferred:
    """The model with what came to it."""

    #: Its files: "" is the main one, others are companions by URI.
    files: dict[str, bytes]
    #: What came, shape by shape, and how well the other model lay on this one.
    report: pb.TransferReport

    def save(self, path: str | Path, *, force: bool = False) -> list[Path]:
        """Writes the files, as `Session.export` does; answers their paths."""
        return model.write(Path(path), self.files, force)


def request(
    session_id: str,
    source: ModelLike | None,
    session: str,
    shape: ModelLike | None,
    landmarks: Sequence[Any],
    formats: Sequence[str],
    fit: bool = False,
    clearance: float | None = None,
) -> pb.TransferRequest:
    """A transfer as the schema carries it; `formats` are those of source, shape and answer."""
    if (source is None) == (not session):
        raise TypeError("transfer: exactly one of source and session is needed")
    kind, shape_kind, output = (text(name, given) for name, given in zip(("format", "shape_format", "output"), formats))
    message = pb.TransferRequest(session_id=session_id, format=kind, shape_format=shape_kind, output=output)
    if source is None:
        message.session = text("session", session)
    else:
        message.model = _model("source", source)
    if shape is not None:
        message.shape = _model("shape", shape)
    if clearance is not None and not fit:
        raise TypeError("transfer: clearance is of fit=True")
    if fit:
        message.fit.SetInParent()
    if clearance is not None:
        with about("clearance"):
            message.fit.clearance = clearance
    with about("landmarks"):
        for own in landmarks:
            landmark(message.landmarks.add(), own)
    return message


def _model(name: str, given: ModelLike) -> bytes:
    """The bytes of a model; none are none."""
    data = _bytes(given)
    if not data:
        raise ValueError(f"{name}: it is empty; a file, or the bytes of one, is allowed")
    return data


def transferred(chunks: Sequence[pb.Chunk]) -> Transferred:
    """What the server answers."""
    return Transferred(model.joined(chunks), chunks[0].transferred)


def _bytes(given: ModelLike) -> bytes:
    return given if isinstance(given, bytes) else Path(given).read_bytes()
