"""Guides: a curve, a lattice or a cage that leads the vertices of a handle.

A guide in its rest shape belongs to a handle (``session.handle(…, guide=…)``); its shape in a pose is a :class:`GuidePose`, which stands
where a pose does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, Union

import numpy as np
import numpy.typing as npt

from .values import array, flag, seen
from .v1 import pliant_pb2 as pb


@dataclass(frozen=True)
class Curve:
    """A smooth curve through points; vertices keep their offset from it."""

    #: n by 3, 2 to 1024 points.
    points: npt.ArrayLike
    #: Vertices keep their distance along the curve from its first point instead of their share of its length.
    keep_length: bool = False

    def to_message(self) -> pb.Guide:
        """The guide as the schema carries it."""
        points = _places("curve: points", self.points).ravel().tolist()
        return pb.Guide(curve=pb.Guide.Curve(points=points, keep_length=flag("keep_length", self.keep_length)))


@dataclass(frozen=True)
class Lattice:
    """A box of control points; what lies in it is led."""

    #: The corner that control points are counted from.
    origin: npt.ArrayLike
    #: 3 by 3: the edges of the box from there, a row each. Three numbers are its size along x, y and z.
    edges: npt.ArrayLike
    #: How many control points there are along each edge, at least 2.
    counts: Sequence[int] = (3, 3, 3)

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """The control points in the rest shape, n by 3, in the order that poses list them."""
        origin, edges = self._box()
        counts = self._counts()
        shares = [np.linspace(0.0, 1.0, count) for count in counts]
        w, v, u = np.meshgrid(shares[2], shares[1], shares[0], indexing="ij")
        points: npt.NDArray[np.float64] = origin + np.stack([u, v, w], axis=-1).reshape(-1, 3) @ edges
        return points

    def to_message(self) -> pb.Guide:
        """The guide as the schema carries it."""
        origin, edges = self._box()
        lattice = pb.Guide.Lattice(origin=origin.tolist(), edges=edges.ravel().tolist(), counts=self._counts())
        return pb.Guide(lattice=lattice)

    def _counts(self) -> list[int]:
        counts: list[int] = _whole("lattice: counts", self.counts).tolist()
        return counts

    def _box(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        origin = array("lattice: origin", self.origin).astype(np.float64)
        edges = array("lattice: edges", self.edges).astype(np.float64)
        if edges.shape == (3,):
            edges = np.diag(edges)
        if origin.shape != (3,) or edges.shape != (3, 3) or len(self.counts) != 3:
            shapes = f"{origin.shape}, {edges.shape} and {len(self.counts)} numbers"
            raise ValueError(f"lattice: origin, edges and counts have shapes {shapes}; (3,), (3, 3) or (3,), and 3 numbers are allowed")
        return origin, edges


@dataclass(frozen=True)
class Cage:
    """A closed triangle mesh around the vertices that it leads."""

    #: n by 3.
    positions: npt.ArrayLike
    #: m by 3 numbers of vertices, counter-clockwise from outside.
    triangles: npt.ArrayLike

    def to_message(self) -> pb.Guide:
        """The guide as the schema carries it."""
        triangles = _whole("cage: triangles", self.triangles)
        if triangles.ndim != 2 or triangles.shape[1] != 3:
            raise ValueError(f"cage: triangles: an array of shape {triangles.shape}, (m, 3) is allowed")
        positions = _places("cage: positions", self.positions).ravel().tolist()
        return pb.Guide(cage=pb.Guide.Cage(positions=positions, triangles=triangles.ravel().astype(np.int64).tolist()))


Guide: TypeAlias = Union[Curve, Lattice, Cage]


@dataclass(frozen=True)
class GuidePose:
    """The shape of a handle's guide in a pose: n by 3 places of its points or control points."""

    positions: npt.ArrayLike
    #: Of a curve, the angle in radians that it is twisted by at each point.
    twists: npt.ArrayLike | None = None
    #: Of a curve, the scale across it at each point.
    scales: npt.ArrayLike | None = None
    #: ``twists`` in degrees; a pose has one of them.
    twist_degrees: npt.ArrayLike | None = None

    def to_message(self) -> pb.HandlePose:
        """The pose as the schema carries it."""
        message = pb.HandlePose()
        if self.twist_degrees is not None:
            if self.twists is not None:
                raise ValueError("twist_degrees: twists are given in radians as well; leave one of them out")
            message.guide.twists.extend(np.radians(array("twist_degrees", self.twist_degrees).astype(np.float64)).ravel().tolist())
        message.guide.positions.extend(_places("positions", self.positions).ravel().tolist())
        for name in ("twists", "scales"):
            values: Any = getattr(self, name)
            if values is not None:
                getattr(message.guide, name).extend(array(name, values).astype(np.float64).ravel().tolist())
        return message


def guide_message(guide: Guide) -> pb.Guide:
    """A guide as the schema carries it."""
    if not isinstance(guide, (Curve, Lattice, Cage)):
        raise TypeError(f"guide: {seen(guide)}, a pliant.Curve, Lattice or Cage is allowed")
    return guide.to_message()


def _whole(name: str, given: npt.ArrayLike) -> npt.NDArray[Any]:
    found = array(name, given)
    if not np.issubdtype(found.dtype, np.integer):
        raise ValueError(f"{name}: values of type {found.dtype}, whole numbers are allowed")
    return found


def _places(what: str, value: npt.ArrayLike) -> npt.NDArray[np.float64]:
    places = array(what, value).astype(np.float64)
    if places.ndim != 2 or places.shape[1] != 3:
        raise ValueError(f"{what}: an array of shape {places.shape}, (n, 3) is allowed")
    return places
