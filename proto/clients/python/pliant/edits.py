"""Edits: operations that change the topology."""

from __future__ import annotations

import os
from base64 import b64decode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex
from typing import Any, Literal, Union

import numpy as np
import numpy.typing as npt
from typing_extensions import TypedDict

from .poses import Vector
from .regions import RegionLike, enum, indices, no_such_setting, plane, region
from .values import about, array, float_points, mapping, put, snake_case
from .v1 import pliant_pb2 as pb


class Cut(TypedDict, total=False):
    """Cuts by a plane (``normal`` and ``offset``, or ``plane``), by a line drawn on the surface, or along edges."""

    #: (normal, offset), or a dict of them, as jobs and HTTP have it.
    plane: Union[tuple[Vector, float], Mapping[str, Any]]
    #: The plane's points have normal . x = offset.
    normal: Vector
    offset: float
    #: (points, 3) of a line on the surface.
    polyline: Any
    #: Render vertices along edges.
    path: Any
    #: The line or path returns to its first point.
    closed: bool
    #: Which sides stay: for a plane above is where the normal points, for a line its left. Default both.
    keep: Literal["both", "above", "below"]
    #: Close the cut.
    fill: bool


class Subdivide(TypedDict, total=False):
    """Splits triangles."""

    region: RegionLike
    scheme: Literal["loop", "midpoint"]
    #: Only triangles too large for the bend between the handles.
    auto: bool
    #: With LOOP, edges sharper than this stay edges, degrees.
    crease_degrees: float
    #: Pairs of render vertices between which edges stay edges, in a row.
    creases: Any
    #: Edges between two primitives stay edges.
    crease_primitives: bool
    #: Below 1 creases are rounded in part.
    sharpness: float


class Decimate(TypedDict, total=False):
    """Removes triangles while keeping the shape."""

    region: RegionLike
    #: Share of triangles to keep, between 0 and 1.
    ratio: float


class Delete(TypedDict, total=False):
    """Removes a region."""

    region: RegionLike
    #: Close the hole.
    fill: bool


class Fill(TypedDict, total=False):
    """Closes holes."""

    region: RegionLike
    #: Flat caps have a material and texture coordinates of their own.
    cap: Literal["continued", "flat"]
    #: The name of that material; "cap" where it is not given.
    material: str


class Remesh(TypedDict, total=False):
    """Evens out triangles."""

    region: RegionLike
    #: Target edge length in model units.
    edge_length: float
    #: Only where stretch or aspect asks for it.
    auto: bool
    #: How far the old and the new surface may be from each other, model units.
    max_deviation: float
    #: An edge stays an edge when the normals of its triangles differ by more, degrees.
    sharp_degrees: float


class Smooth(TypedDict, total=False):
    """Moves vertices: off with noise, or to more even triangles."""

    region: RegionLike
    kind: Literal["smooth", "relax"]
    #: How often; 10 where it is not given.
    iterations: int
    #: How far each time, above 0 and up to 1; 0.5 where it is not given.
    strength: float
    #: An edge stays an edge when the normals of its triangles differ by more, degrees.
    sharp_degrees: float


class Merge(TypedDict, total=False):
    """Adds another model: a file or its bytes, or another session by id."""

    model: Union[str, os.PathLike[str], bytes]
    session: str
    #: 4 by 4, column vectors, translation in the last column.
    transform: Any
    how: Literal["weld", "stitch", "loose"]
    #: Largest distance of boundary vertices that are welded, in model units.
    tolerance: float
    #: Format of the model, where its bytes do not show it.
    format: str


class Wrap(TypedDict, total=False):
    """Moves all vertices so that the surface lies on that of another model: a file or its bytes, or another session by id."""

    model: Union[str, os.PathLike[str], bytes]
    session: str
    #: Pairs (own, target) of vertex numbers or points (x, y, z), or dicts of the schema's fields.
    landmarks: Sequence[Any]
    #: What the target does not pull.
    mask: Any
    #: The result stays in the place and of the size of the model.
    in_place: bool
    #: Format of the model, where its bytes do not show it.
    format: str


class Unintersect(TypedDict, total=False):
    """Moves vertices as little as is needed for triangles of the model not to cross."""

    #: What stays where it is.
    fixed: Any
    #: What surfaces that crossed are to keep from each other, in model units.
    clearance: float


class InsertCurve(TypedDict, total=False):
    """Inserts a polyline into the surface as edges."""

    #: (points, 3).
    points: Any
    #: The line returns to its first point.
    closed: bool


class Weld(TypedDict, total=False):
    """Welds vertices."""

    #: Largest distance, in model units.
    tolerance: float


class Clean(TypedDict, total=False):
    """Takes away small parts and hidden copies."""

    #: How many parts stay, those with the largest area.
    keep_largest: int
    #: Parts go whose area is a smaller share of the largest part's, up to 1.
    smallest_share: float
    #: Parts go whose box has a shorter diagonal, in model units.
    smallest_size: float
    #: Triangles go whose corners are at most this far from those of an earlier one.
    duplicates_within: float


class Adopt(TypedDict, total=False):
    """Makes a shape the rest pose: the current one, or the one that positions give. ``Session.adopt`` sends large ones in parts."""

    #: (n, 3), in model space; in jobs relative to ``info.origin``. Absent: the shape as it is.
    positions: npt.ArrayLike
    #: Of a shape in parts: how many vertices the parts before have.
    first: int
    #: More parts follow.
    more: bool
    #: Of a shape in parts: a name made up for it, the same in all parts.
    shape: str


class EditFields(TypedDict, total=False):
    """One operation; exactly one key is given."""

    cut: Cut
    subdivide: Subdivide
    decimate: Decimate
    delete: Delete
    fill: Fill
    remesh: Remesh
    smooth: Smooth
    merge: Merge
    wrap: Wrap
    unintersect: Unintersect
    insert_curve: InsertCurve
    weld: Weld
    clean: Clean
    adopt: Adopt


@dataclass(frozen=True)
class EditResult:
    """What an edit did."""

    #: The session's revision.
    revision: int
    #: Render vertices and triangles before.
    before: tuple[int, int]
    #: Render vertices and triangles after.
    after: tuple[int, int]
    #: Handles that still hold vertices.
    handles_kept: list[str]
    #: What was noticed.
    warnings: list[pb.Warning]
    #: Milliseconds by stage.
    ms: dict[str, float]
    #: For every render vertex of before its number now, or -1 where it is gone.
    now_from_before: npt.NDArray[np.int64]
    #: Render vertices along an inserted curve.
    curve: list[int]
    #: Digest of the positions after it.
    digest: str
    #: Of a wrap: how well the surface lies on the target.
    wrap: pb.WrapReport | None = None
    #: Of `unintersect`: what became of triangles that crossed.
    unintersect: pb.UnintersectReport | None = None


OPERATIONS = tuple(EditFields.__annotations__)


def request(
    session_id: str, on: str, fields: Mapping[str, Any], count: int | None = None, origin: Sequence[float] = ()
) -> pb.EditRequest:
    """An edit of a model with `count` render vertices as the schema carries it, in a session with this `origin`.

    Operations and settings may also be spelled as jobs and HTTP spell them: ``insertCurve``, ``edgeLength``, enums in capitals, points
    in a row, a transform as 16 numbers.
    """
    fields = {snake_case(name): settings for name, settings in fields.items()}
    if len(fields) != 1 or next(iter(fields)) not in OPERATIONS:
        seen = ", ".join(fields) or "nothing"
        raise ValueError(f"edit: {seen} is given, exactly one of {', '.join(OPERATIONS)} is allowed")
    name, given = next(iter(fields.items()))
    message = pb.EditRequest(session_id=session_id, on=enum("on", pb.EditRequest.On, on))
    settings = dict(mapping(name, given, "a dict of its settings"))
    with about(name):
        if len(origin) == 3 and not isinstance(settings.get("positions", ""), str):
            settings = {**settings, "positions": array("positions", settings["positions"]).astype(float) - np.array(origin)}
        _fill(name, getattr(message, name), settings, count)
    getattr(message, name).SetInParent()
    return message


#: Vertices of a shape that travel in one message at most: 1 MiB.
PART = (1 << 20) // 12


def adoptions(session: pb.Session, on: str, positions: npt.ArrayLike | None, vertices: int) -> list[pb.EditRequest]:
    """The edits that make a shape the rest pose: one, or one for each part of it."""
    if positions is None:
        return [request(session.id, on, {"adopt": {}}, vertices)]
    with about("adopt"):
        data = float_points("positions", positions, session.origin)
    count = len(data) // 12
    shape = token_hex(8) if count > PART else ""
    parts = []
    for first in range(0, max(count, 1), PART):
        end = min(first + PART, count)
        message = request(session.id, on, {"adopt": {"first": first, "more": end < count, "shape": shape}}, vertices)
        message.adopt.positions = data[12 * first : 12 * end]
        parts.append(message)
    return parts


def _fill(name: str, operation: Any, given: dict[str, Any], count: int | None) -> None:
    given = {snake_case(key): value for key, value in given.items()}
    if name == "cut" and ("normal" in given or "offset" in given):
        if "plane" in given:
            raise TypeError("plane is given beside normal and offset; one of both is allowed")
        given["plane"] = (given.pop("normal", ()), given.pop("offset", 0.0))
    for key, value in given.items():
        if key == "region":
            operation.region.CopyFrom(region(value, count))
        elif key in ("keep", "scheme", "how", "kind", "cap"):
            setattr(operation, key, enum(key, _ENUMS[key], value))
        elif key == "plane" and name == "cut":
            operation.plane.CopyFrom(plane(value))
        elif key == "transform":
            matrix = array(key, value).astype(np.float64)
            if matrix.shape not in ((4, 4), (16,)):
                allowed = "(4, 4) is allowed, or 16 numbers, column by column"
                raise ValueError(f"a transform of shape {matrix.shape}, {allowed}")
            operation.transform.extend(matrix.T.ravel().tolist())
        elif key in ("points", "polyline"):
            points = array(key, value).astype(np.float64)
            in_a_row = points.ndim == 1 and points.size % 3 == 0
            if not in_a_row and (points.ndim != 2 or points.shape[1] != 3):
                raise ValueError(f"{key} of shape {points.shape}, (points, 3) is allowed, or x, y, z of each in a row")
            getattr(operation, key).extend(points.ravel().tolist())
        elif key == "positions":
            # Jobs have bytes as base64.
            operation.positions = b64decode(value) if isinstance(value, str) else float_points(key, value)
        elif key in ("path", "creases"):
            getattr(operation, key).extend(indices(key, np.ravel(value)).tolist())
        elif key in ("mask", "fixed"):
            getattr(operation, key).CopyFrom(region(value, count))
        elif key == "landmarks":
            for own in value:
                landmark(operation.landmarks.add(), own)
        elif key in ("model", "file") and name in ("merge", "wrap"):
            operation.model = value if isinstance(value, bytes) else Path(value).read_bytes()
        elif key in operation.DESCRIPTOR.fields_by_name:
            put(operation, key, value)
        else:
            own = ("normal", "offset") if name == "cut" else ()
            raise no_such_setting(key, (*operation.DESCRIPTOR.fields_by_name, *own))


def landmark(message: Any, given: Any) -> None:
    """A pair (own, target), or a dict of the schema's fields."""
    if isinstance(given, Mapping):
        for key, value in given.items():
            key = snake_case(key)
            if key in ("own_point", "target_point"):
                getattr(message, key).extend(array(key, value).astype(np.float64).ravel().tolist())
            elif key in message.DESCRIPTOR.fields_by_name:
                put(message, key, value)
            else:
                raise no_such_setting(key, tuple(message.DESCRIPTOR.fields_by_name))
        return
    own, target = given
    for side, place in (("own", own), ("target", target)):
        if isinstance(place, (int, np.integer)):
            setattr(message, f"{side}_vertex", int(place))
        else:
            getattr(message, f"{side}_point").extend(array(side, place).astype(np.float64).ravel().tolist())


_ENUMS: dict[str, Any] = {
    "keep": pb.EditRequest.Cut.Keep,
    "scheme": pb.EditRequest.Subdivide.Scheme,
    "how": pb.EditRequest.Merge.How,
    "kind": pb.EditRequest.Smooth.Kind,
    "cap": pb.EditRequest.Cap,
}


def result(message: pb.EditResult) -> EditResult:
    """What the server says that it did."""
    now_from_before = np.full(message.before.vertices, -1, np.int64)
    for run in message.kept:
        now_from_before[run.was : run.was + run.count] = np.arange(run.now, run.now + run.count)
    return EditResult(
        revision=message.revision,
        before=(message.before.vertices, message.before.faces),
        after=(message.after.vertices, message.after.faces),
        handles_kept=list(message.handles_kept),
        warnings=list(message.warnings),
        ms=dict(message.ms),
        now_from_before=now_from_before,
        curve=list(message.curve),
        digest=message.digest,
        wrap=message.wrap if message.HasField("wrap") else None,
        unintersect=message.unintersect if message.HasField("unintersect") else None,
    )
