"""A session in a notebook: its mesh, and a dot for each handle, which the pointer drags. It needs ``pip install 'pliant[notebook]'``.

The front end is ``notebook.js``. It sends one request at a time, as a custom message, and each gets one answer; the shape and the
handles as they are committed are synchronized traits.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .errors import NotFound, PliantError
from .frames import Positions
from .poses import Pose, matrix_of, quaternion_of
from .v1 import pliant_pb2 as pb

try:
    import anywidget
    import traitlets
except ImportError as missing:
    raise ImportError("a widget needs anywidget: pip install 'pliant[notebook]'") from missing

if TYPE_CHECKING:
    from .session import Session
    from .stream import Stream

_Doubles = npt.NDArray[np.float64]


def show(session: Session, *, height: int = 420, free_rotation: bool = True) -> Widget:
    """A widget of a session, as :meth:`pliant.Session.widget` makes it."""
    return Widget(session, height=height, free_rotation=free_rotation)


class Widget(anywidget.AnyWidget):
    """The mesh of a session, and a dot for each handle. Made by :meth:`pliant.Session.widget`; the last line of a cell shows it.

    Dragging a dot moves its handle, with Shift it turns it about its joint; Escape takes the drag back, and letting go records the pose.
    """

    _esm = Path(__file__).parent / "notebook.js"
    _css = Path(__file__).parent / "notebook.css"

    #: Height in pixels.
    height = traitlets.Int(420).tag(sync=True)
    #: The committed shape, x, y, z of each render vertex as 32-bit floats relative to the session's origin.
    positions = traitlets.Bytes().tag(sync=True)
    #: Three 32-bit vertex numbers a triangle.
    triangles = traitlets.Bytes().tag(sync=True)
    #: Of each vertex, the first one at the same place, whose normal it shares.
    welded = traitlets.Bytes().tag(sync=True)
    #: The ``id`` of each handle, and its ``place``, where its dot is.
    handles: Any = traitlets.List().tag(sync=True)
    #: What is shown, in words.
    status = traitlets.Unicode().tag(sync=True)

    def __init__(self, session: Session, *, height: int = 420, free_rotation: bool = True) -> None:
        super().__init__(height=height)
        self._session = session
        self._free_rotation = free_rotation
        self._revision = -1
        self._held: _Held | None = None
        self.refresh()
        self.on_msg(self._hear)

    def refresh(self) -> None:
        """Shows the session as it is now, after changes that were not made in this widget. A drag looks for them as it begins."""
        self._session.apply()
        self._session.refresh()
        positions, triangles = self._session.positions(), self._session.triangles()
        _, first, inverse = np.unique(positions, axis=0, return_index=True, return_inverse=True)
        with self.hold_sync():
            self.triangles = triangles.astype("<u4").tobytes()
            self.welded = first[inverse.ravel()].astype("<u4").tobytes()
            self._show(positions)

    def _show(self, positions: Positions) -> None:
        """Takes over a committed shape, and what the session says of it."""
        info = self._session.info
        self.positions = self._sent(positions)
        origin = np.array(info.origin or (0.0, 0.0, 0.0))
        self.handles = [{"id": handle.id, "place": (Placed.of(handle).place - origin).tolist()} for handle in info.handles]
        self.status = f"{info.label or 'session'}: {self._session.vertices:,} vertices, revision {info.revision}"
        self._revision = info.revision

    def _sent(self, positions: Positions) -> bytes:
        origin = self._session.info.origin
        return (positions - np.array(origin) if origin else positions).astype("<f4").tobytes()

    def _hear(self, _: object, request: dict[str, Any], buffers: object) -> None:
        """Does what the front end asks for, and answers it, whatever happens: the front end waits for that."""
        answer, shapes = {"view": request.get("view"), "error": ""}, []
        try:
            if request["kind"] == "drag":
                shapes = self._drag(request)
            else:
                {"undo": self._session.undo, "redo": self._session.redo}[request["kind"]]()
                self.refresh()
        except Exception as error:
            answer["error"] = str(error) if isinstance(error, PliantError) else f"{type(error).__name__}: {error}"
            self._let_go()
            with suppress(PliantError):
                self.refresh()
        self.send(answer, shapes)

    def _drag(self, request: dict[str, Any]) -> list[bytes]:
        """One step of a drag: the shape where it is under way, which is not committed."""
        held = self._held or self._grab(request["id"])
        if request.get("cancel"):
            self._let_go()
            return []
        pose = {request["id"]: held.start.moved(request["by"], request["turn"], self._free_rotation)}
        if not request["end"]:
            held.stream.send(pose)
            return [self._sent(held.stream.wait().positions)]
        frame = held.stream.commit(pose)
        self._let_go()
        self._session.refresh()
        with self.hold_sync():
            self._show(frame.positions)
        return []

    def _grab(self, id: str) -> _Held:
        if self._session.refresh().revision != self._revision:
            self.refresh()
        found = {handle.id: handle for handle in self._session.info.handles}
        if id not in found:
            raise NotFound(f"the session has no handle {id!r} any more")
        self._held = _Held(Placed.of(found[id]), self._session.stream())
        return self._held

    def _let_go(self) -> None:
        held, self._held = self._held, None
        if held is not None:
            held.stream.close()


@dataclass(frozen=True)
class Placed:
    """Where a handle is: a point x of the rest pose is at ``pivot + linear (x - pivot) + translation``."""

    facts: pb.HandleFacts
    linear: _Doubles
    pivot: _Doubles
    translation: _Doubles

    @staticmethod
    def of(facts: pb.HandleFacts) -> Placed:
        """The place that the server reports."""
        pose = facts.pose
        turned = matrix_of(() if facts.found_turn else pose.rotation, facts.found_turn or pose.rotation_vector)
        default = facts.centroid if pose.free_rotation else facts.pivot
        pivot, translation = np.array(pose.pivot or default), np.array(pose.translation or (0.0, 0.0, 0.0))
        return Placed(facts, turned * np.array(pose.scale or (1.0,)), pivot, translation)

    def about(self, pivot: _Doubles) -> _Doubles:
        """The translation of the same pose about another pivot."""
        away = self.pivot - pivot
        translation: _Doubles = self.translation + away - self.linear @ away
        return translation

    @property
    def place(self) -> _Doubles:
        """Where the middle of the handle is."""
        centroid = np.array(self.facts.centroid)
        return centroid + self.about(centroid)

    def moved(self, by: Sequence[float], turn: Sequence[float], is_free: bool) -> Pose:
        """The pose after the middle of the handle has moved by a vector, or the handle has turned about its joint (axis times angle). With
        `is_free` what is moved turns freely, unless it was turned by somebody.
        """
        pose = self.facts.pose
        scale, rotation = list(pose.scale) or None, None if self.facts.found_turn else list(pose.rotation) or None
        vector = list(self.facts.found_turn or pose.rotation_vector) or None
        if any(turn):
            joint = np.array(self.facts.pivot)
            turned = quaternion_of(matrix_of((), turn) @ matrix_of(rotation or (), vector or ()))
            return Pose(self.about(joint), turned, scale=scale, pivot=joint)
        centroid = np.array(self.facts.centroid)
        is_free = pose.free_rotation or (is_free and rotation is None and vector is None)
        return Pose(self.about(centroid) + np.array(by), rotation, vector, scale, centroid, is_free)


@dataclass(frozen=True)
class _Held:
    """A drag under way."""

    start: Placed
    stream: Stream
