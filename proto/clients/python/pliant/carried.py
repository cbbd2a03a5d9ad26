"""Points, and models, carried along with a session's shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .values import array, text
from .v1 import pliant_pb2 as pb

Doubles = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Carried:
    """Where points have been carried, in the order in which they were given."""

    #: Where each point is now, (points, 3).
    positions: Doubles
    #: How the axes at each point are turned now: unit quaternions x, y, z, w, (points, 4).
    rotations: Doubles
    #: How many times as large lengths around each point are now, (points,).
    scales: Doubles
    #: The session's revision.
    revision: int


def points_request(session: str, points: Any, rotations: Any) -> pb.CarryRequest:
    """Asks for points, (points, 3) or one of three numbers, with the axes at them."""
    places = _rows("points", points, 3)
    request = pb.CarryRequest(session_id=session, points=places.ravel())
    if rotations is not None:
        turned = _rows("rotations", rotations, 4)
        if len(turned) != len(places):
            raise ValueError(f"rotations: {len(turned)} of them, one for each of {len(places)} points is needed")
        request.rotations.extend(turned.ravel())
    return request


def model_request(session: str, model: Any, format: str) -> pb.CarryRequest:
    """Asks for a model in the rest space."""
    if not isinstance(model, (bytes, bytearray, memoryview)):
        raise TypeError(f"model: {type(model).__name__}, the bytes of a model file are needed")
    return pb.CarryRequest(session_id=session, model=bytes(model), format=text("format", format))


def carried(answer: pb.CarryResponse) -> Carried:
    """Points as the server answered them."""
    return Carried(
        positions=np.array(answer.points, dtype=np.float64).reshape(-1, 3),
        rotations=np.array(answer.rotations, dtype=np.float64).reshape(-1, 4),
        scales=np.array(answer.scales, dtype=np.float64),
        revision=answer.revision,
    )


def _rows(what: str, values: Any, width: int) -> Doubles:
    rows = np.atleast_2d(array(what, values)).astype(np.float64)
    if rows.ndim != 2 or rows.shape[1] != width or not len(rows):
        raise ValueError(f"{what}: an array of shape {np.shape(values)}, (points, {width}) is needed")
    return rows
