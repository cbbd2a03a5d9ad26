"""Regions: which vertices a handle or an edit takes. They are taken in the rest pose and in model space."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias, Union

import numpy as np
import numpy.typing as npt
from typing_extensions import TypedDict

from .guides import Guide, guide_message
from .poses import Vector, numbers
from .values import about, array, mapping, number, put, seen, snake_case, text, whole
from .v1 import pliant_pb2 as pb

#: Runs of vertices of at least this length travel as first and count.
_RUN = 4


class RegionFields(TypedDict, total=False):
    """One way to name vertices; exactly one key is given.

    Each value may also be a dict as jobs and HTTP have it, such as ``{"center": [0, 1, 0], "radius": 0.5}`` of a sphere, and each
    name may be spelled as there, such as ``halfSpace``.
    """

    #: Render vertices: indices, or a boolean mask over all of them.
    vertices: Union[Sequence[int], npt.NDArray[Any], Mapping[str, Any]]
    #: (normal, offset): points with normal . x >= offset.
    half_space: Union[tuple[Vector, float], Mapping[str, Any]]
    #: (center, radius).
    sphere: Union[tuple[Vector, float], Mapping[str, Any]]
    #: (lowest corner, highest corner).
    box: Union[tuple[Vector, Vector], Mapping[str, Any]]
    #: (one end, other end, radius).
    capsule: Union[tuple[Vector, Vector, float], Mapping[str, Any]]
    #: (points of a polyline, radius).
    tube: Union[tuple[Any, float], Mapping[str, Any]]
    #: Number of a connected component, by smallest vertex.
    component: Union[int, Mapping[str, Any]]
    #: Number of an entry of ``Session.info.primitives``.
    primitive: Union[int, Mapping[str, Any]]
    #: A weight for every render vertex, 0 to 1; those above 0 are in the region.
    weights: Union[Vector, Mapping[str, Any]]
    #: Points of the surface, for targets: (triangles, barycentric weights n by 3), where triangles are n numbers, or n by 3
    #: render vertices.
    anchors: Union[tuple[Any, Any], Mapping[str, Any]]


RegionLike: TypeAlias = Union[RegionFields, pb.Region]
REGIONS = ("vertices", "half_space", "sphere", "box", "capsule", "tube", "component", "primitive", "weights", "anchors")


def region(fields: RegionLike | Mapping[str, Any], count: int | None = None) -> pb.Region:
    """A region of a model with `count` render vertices, where that is known, as the schema carries it."""
    if isinstance(fields, pb.Region):
        return fields
    named = mapping("region", fields, f"a dict of one of {', '.join(REGIONS)}")
    given: dict[str, Any] = {snake_case(name): value for name, value in named.items() if value is not None}
    if len(given) != 1 or not set(given) <= set(REGIONS):
        seen = ", ".join(given) or "nothing"
        raise ValueError(f"region: {seen} is given, exactly one of {', '.join(REGIONS)} is allowed")
    name, value = next(iter(given.items()))
    if isinstance(value, Mapping):
        message = pb.Region()
        with about(name):
            fill(getattr(message, name), value)
        getattr(message, name).SetInParent()
        return message
    if name == "vertices":
        return pb.Region(vertices=vertices(value, count))
    if name == "anchors":
        return pb.Region(anchors=anchors(value))
    if name == "component":
        return pb.Region(component=pb.Region.Part(index=whole(name, value)))
    if name == "primitive":
        return pb.Region(primitive=pb.Region.Part(index=whole(name, value)))
    if name == "weights":
        values = line(name, array(name, value))
        return pb.Region(weights=pb.Region.Weights(values=values.astype(np.float32)))
    return _shape(name, value)


def anchors(value: Any) -> pb.Region.Anchors:
    """Points of the surface as the schema carries them."""
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise ValueError(f"anchors: (triangles, weights) is allowed, or a dict of faces or corners and weights, not {seen(value)}")
    corners, weights = array("anchors' triangles", value[0]), array("anchors' weights", value[1]).astype(np.float32)
    if corners.dtype.kind not in "iu" or (corners.size and corners.min() < 0):
        raise ValueError("anchors' triangles: whole numbers from 0 on are allowed")
    if corners.ndim not in (1, 2) or corners.shape[1:] not in ((), (3,)):
        raise ValueError(f"anchors' triangles have shape {corners.shape}, (anchors,) or (anchors, 3) is allowed")
    if weights.shape != (len(corners), 3):
        raise ValueError(f"anchors' weights have shape {weights.shape}, ({len(corners)}, 3) is allowed")
    message = pb.Region.Anchors(weights=weights.ravel().tolist())
    (message.faces if corners.ndim == 1 else message.corners).extend(corners.ravel().tolist())
    return message


def _shape(name: str, value: Any) -> pb.Region:
    parts = {"half_space": 2, "sphere": 2, "box": 2, "capsule": 3, "tube": 2}[name]
    if not isinstance(value, (tuple, list)) or len(value) != parts:
        keys = ", ".join(getattr(pb.Region(), name).DESCRIPTOR.fields_by_name)
        raise ValueError(f"{name}: {_FORMS[name]} is allowed, or a dict of {keys}, not {seen(value)}")
    if name == "half_space":
        normal = numbers("half_space's normal", value[0], (3,))
        return pb.Region(half_space=pb.Region.HalfSpace(normal=normal, offset=number("half_space's offset", value[1])))
    if name == "sphere":
        center = numbers("sphere's center", value[0], (3,))
        return pb.Region(sphere=pb.Region.Sphere(center=center, radius=number("sphere's radius", value[1])))
    if name == "box":
        low, high = (numbers("box's corner", corner, (3,)) for corner in value)
        return pb.Region(box=pb.Region.Box(min=low, max=high))
    if name == "capsule":
        ends = {"from": numbers("capsule's end", value[0], (3,)), "to": numbers("capsule's end", value[1], (3,))}
        capsule: Any = {**ends, "radius": number("capsule's radius", value[2])}  # `from` is a word of Python
        return pb.Region(capsule=pb.Region.Capsule(**capsule))
    points = array("tube's points", value[0]).astype(np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"tube's points have shape {points.shape}, (points, 3) is allowed")
    return pb.Region(tube=pb.Region.Tube(points=points.ravel().tolist(), radius=number("tube's radius", value[1])))


_FORMS = {
    "half_space": "(normal, offset)",
    "sphere": "(center, radius)",
    "box": "(lowest corner, highest corner)",
    "capsule": "(one end, other end, radius)",
    "tube": "(points, radius)",
}


def fill(message: Any, fields: Mapping[str, Any]) -> None:
    """Sets the fields of a message that is spelled as jobs and HTTP spell it; lists of points may have one row a point."""
    for key, value in fields.items():
        name = snake_case(key)
        field = message.DESCRIPTOR.fields_by_name.get(name)
        if field is None:
            raise no_such_setting(key, message.DESCRIPTOR.fields_by_name)
        held = getattr(message, name)
        if not hasattr(held, "extend"):
            if field.message_type is None:
                put(message, name, value)
            else:
                fill(held, mapping(name, value, "a dict"))
        elif field.message_type is not None:
            for entry in value:
                fill(held.add(), mapping(name, entry, "a list of dicts"))
        elif field.cpp_type == field.CPPTYPE_UINT32:
            held.extend(indices(name, value).tolist())
        else:
            held.extend(array(name, value).astype(np.float64).ravel().tolist())


def no_such_setting(seen: str, allowed: Iterable[str]) -> TypeError:
    """The refusal of a setting that does not exist."""
    return TypeError(f"no such setting as {seen}; allowed are {', '.join(allowed)}")


def line(what: str, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """An array of one dimension: what has more is meant otherwise than it would be taken."""
    if values.ndim != 1:
        raise ValueError(f"{what}: an array of shape {values.shape}, one dimension is allowed")
    return values


def indices(what: str, chosen: Any) -> npt.NDArray[Any]:
    """Vertices by number, in their order."""
    with about(what):
        found = np.asarray(chosen)
    if found.size and not np.issubdtype(found.dtype, np.integer):
        raise ValueError(f"{what}: values of type {found.dtype}, indices are allowed")
    for extreme in (int(found.min()), int(found.max())) if found.size else ():
        if not 0 <= extreme < 1 << 32:
            raise ValueError(f"{what}: {extreme}, indices from 0 are allowed")
    return line(what, found)


def vertices(chosen: Sequence[int] | npt.NDArray[Any], count: int | None = None) -> pb.Region.Vertices:
    """Vertices as single indices and runs; a boolean array is a mask over all `count` of them."""
    with about("vertices"):
        given = np.asarray(chosen)
    if given.dtype == np.bool_:
        if count is not None and line("vertices", given).size != count:
            raise ValueError(f"vertices: a mask of {given.size} values, the model's {count} are allowed")
        given = np.flatnonzero(line("vertices", given))
    elif given.size and not np.issubdtype(given.dtype, np.integer):
        raise ValueError(f"vertices: values of type {given.dtype}, indices or a boolean mask are allowed")
    rising = np.unique(indices("vertices", given)).astype(np.int64)
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
    targets: bool | str,
    tangential: float,
    guide: Guide | None = None,
    fields: RegionLike | Mapping[str, Any],
    count: int | None = None,
) -> pb.Handle:
    """A handle on a model with `count` render vertices as the schema carries it."""
    message = pb.Handle(id=id, region=region(fields, count), pose=pose)
    put(message, "rigid", rigid)
    if isinstance(constrains, str):
        raise TypeError(f"constrains: {constrains!r}, a list of names is allowed")
    for name in constrains or ():
        message.constrains.append(enum("constrains", pb.Handle.Constrains, name))
    if stiffness is not None:
        put(message, "stiffness", stiffness)
    if falloff is not None:
        if not isinstance(falloff, (tuple, list)) or len(falloff) != 2:
            raise TypeError(f"falloff: {seen(falloff)}, (radius, kind) is allowed")
        radius, kind = number("falloff's radius", falloff[0]), enum("falloff", pb.Falloff.Kind, falloff[1])
        message.falloff.CopyFrom(pb.Falloff(radius=radius, kind=kind))
    if targets is not False:
        per = "vertex" if targets is True else targets
        message.targets.stiffness_per = enum("targets", pb.Handle.Targets.StiffnessPer, per)
        message.targets.tangential = number("tangential", tangential)
        message.targets.SetInParent()
    if guide is not None:
        message.guide.CopyFrom(guide_message(guide))
    return message


def enum(what: str, kind: Any, name: object) -> Any:
    """The value of an enum of the schema by its name in any case."""
    try:
        return kind.Value(text(what, name).upper().replace("-", "_"))
    except (TypeError, ValueError) as wrong:
        allowed = ", ".join(known.lower() for known in kind.keys())
        refusal = TypeError if isinstance(wrong, TypeError) else ValueError
        raise refusal(f"{what}: {seen(name)}, one of {allowed} is allowed") from None


def plane(value: tuple[Vector, float] | Mapping[str, Any]) -> pb.Plane:
    """(normal, offset), or a dict of them: points with normal . x = offset."""
    if isinstance(value, Mapping):
        message = pb.Plane()
        with about("plane"):
            fill(message, value)
        return message
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise ValueError(f"plane: (normal, offset) is allowed, or a dict of normal, offset, not {seen(value)}")
    return pb.Plane(normal=numbers("plane's normal", value[0], (3,)), offset=number("plane's offset", value[1]))
