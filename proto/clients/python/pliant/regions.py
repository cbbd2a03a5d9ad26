"""Regions: which vertices a handle or an edit takes. They are taken in the rest pose and in model space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias, Union

import numpy as np
import numpy.typing as npt
from typing_extensions import TypedDict

from .poses import Vector, numbers
from .v1 import pliant_pb2 as pb

#: Runs of vertices of at least this length travel as first and count.
_RUN = 4


class RegionFields(TypedDict, total=False):
    """One way to name vertices; exactly one key is given."""

    #: Render vertices: indices, or a boolean mask over all of them.
    vertices: Union[Sequence[int], npt.NDArray[Any]]
    #: (normal, offset): points with normal . x >= offset.
    half_space: tuple[Vector, float]
    #: (center, radius).
    sphere: tuple[Vector, float]
    #: (lowest corner, highest corner).
    box: tuple[Vector, Vector]
    #: (one end, other end, radius).
    capsule: tuple[Vector, Vector, float]
    #: (points of a polyline, radius).
    tube: tuple[Any, float]
    #: Number of a connected component, by smallest vertex.
    component: int
    #: Number of an entry of ``Session.info.primitives``.
    primitive: int
    #: A weight for every render vertex, 0 to 1; those above 0 are in the region.
    weights: Vector


RegionLike: TypeAlias = Union[RegionFields, pb.Region]
REGIONS = ("vertices", "half_space", "sphere", "box", "capsule", "tube", "component", "primitive", "weights")


def region(fields: RegionLike | Mapping[str, Any]) -> pb.Region:
    """A region as the schema carries it."""
    if isinstance(fields, pb.Region):
        return fields
    given: dict[str, Any] = {name: value for name, value in fields.items() if value is not None}
    if len(given) != 1 or not set(given) <= set(REGIONS):
        seen = ", ".join(given) or "nothing"
        raise ValueError(f"region: {seen} is given, exactly one of {', '.join(REGIONS)} is allowed")
    name, value = next(iter(given.items()))
    if name == "vertices":
        return pb.Region(vertices=vertices(value))
    if name == "component":
        return pb.Region(component=pb.Region.Part(index=int(value)))
    if name == "primitive":
        return pb.Region(primitive=pb.Region.Part(index=int(value)))
    if name == "weights":
        values = np.asarray(value, dtype=np.float32).ravel()
        return pb.Region(weights=pb.Region.Weights(values=values))
    return _shape(name, value)


def _shape(name: str, value: Any) -> pb.Region:
    parts = {"half_space": 2, "sphere": 2, "box": 2, "capsule": 3, "tube": 2}[name]
    if not isinstance(value, (tuple, list)) or len(value) != parts:
        raise ValueError(f"{name}: {_FORMS[name]} is allowed, not {value!r}")
    if name == "half_space":
        normal = numbers("half_space's normal", value[0], (3,))
        return pb.Region(half_space=pb.Region.HalfSpace(normal=normal, offset=float(value[1])))
    if name == "sphere":
        center = numbers("sphere's center", value[0], (3,))
        return pb.Region(sphere=pb.Region.Sphere(center=center, radius=float(value[1])))
    if name == "box":
        low, high = (numbers("box's corner", corner, (3,)) for corner in value)
        return pb.Region(box=pb.Region.Box(min=low, max=high))
    if name == "capsule":
        ends = {"from": numbers("capsule's end", value[0], (3,)), "to": numbers("capsule's end", value[1], (3,))}
        capsule: Any = {**ends, "radius": float(value[2])}  # `from` is a word of Python
        return pb.Region(capsule=pb.Region.Capsule(**capsule))
    points = np.asarray(value[0], dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"tube's points have shape {points.shape}, (points, 3) is allowed")
    return pb.Region(tube=pb.Region.Tube(points=points.ravel().tolist(), radius=float(value[1])))


_FORMS = {
    "half_space": "(normal, offset)",
    "sphere": "(center, radius)",
    "box": "(lowest corner, highest corner)",
    "capsule": "(one end, other end, radius)",
    "tube": "(points, radius)",
}


def vertices(chosen: Sequence[int] | npt.NDArray[Any]) -> pb.Region.Vertices:
    """Vertices as single indices and runs; a boolean array is a mask."""
    array = np.asarray(chosen)
    if array.dtype == np.bool_:
        array = np.flatnonzero(array)
    if array.size and not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"vertices: numbers of type {array.dtype}, indices or a boolean mask are allowed")
    if array.size and int(array.min()) < 0:
        raise ValueError(f"vertices: {int(array.min())}, indices from 0 are allowed")
    rising = np.unique(array.ravel()).astype(np.int64)
    starts = np.flatnonzero(np.diff(rising, prepend=-2) != 1)
    counts = np.diff(starts, append=rising.size)
    long = counts >= _RUN
    runs = [
        pb.Region.Range(first=int(rising[start]), count=int(count)) for start, count in zip(starts[long], counts[long])
    ]
    single = rising[~np.repeat(long, counts)]
    return pb.Region.Vertices(indices=single.tolist(), ranges=runs)


def handle(
    id: str,
    *,
    pose: pb.HandlePose,
    constrains: Sequence[str] | None,
    stiffness: float | None,
    rigid: bool,
    falloff: tuple[float, str] | None,
    fields: RegionLike | Mapping[str, Any],
) -> pb.Handle:
    """A handle as the schema carries it."""
    message = pb.Handle(id=id, region=region(fields), rigid=rigid, pose=pose)
    for name in constrains or ():
        message.constrains.append(enum("constrains", pb.Handle.Constrains, name))
    if stiffness is not None:
        message.stiffness = stiffness
    if falloff is not None:
        message.falloff.CopyFrom(
            pb.Falloff(radius=falloff[0], kind=enum("falloff", pb.Falloff.Kind, falloff[1])),
        )
    return message


def enum(what: str, kind: Any, name: str) -> Any:
    """The value of an enum of the schema by its name in any case."""
    try:
        return kind.Value(name.upper().replace("-", "_"))
    except ValueError:
        allowed = ", ".join(known.lower() for known in kind.keys())
        raise ValueError(f"{what}: {name!r}, one of {allowed} is allowed") from None


def plane(value: tuple[Vector, float]) -> pb.Plane:
    """(normal, offset): points with normal . x = offset."""
    return pb.Plane(normal=numbers("plane's normal", value[0], (3,)), offset=float(value[1]))
