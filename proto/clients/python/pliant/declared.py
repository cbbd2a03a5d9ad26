"""What a session notes down before it sends it to the server: handles, symmetry, the region of interest.

The part that the synchronous and the asyncio session have in common.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, Union

from typing_extensions import Unpack

from . import errors, preview, regions
from .books import Books
from .guides import Guide
from .poses import Pose, Vector, to_message
from .regions import RegionFields
from .values import about, seen, text
from .v1 import pliant_pb2 as pb

#: Which poses of a drag are recorded: none, every one, or the last.
CommitWish = Union[bool, Literal["last"]]

#: Seconds for which a lost connection is looked for to close a session, which expires otherwise.
CLOSE_SECONDS = 2.0

#: What closing a session may meet in peace: it is gone, or goes when its time is over. The client was closed before it
#: where the precondition fails.
GONE = (errors.NotFound, errors.Unavailable, errors.LocalServerError, errors.FailedPrecondition)


class Declared:
    """A session's facts and the handles that are to hold in it."""

    def __init__(self, books: Books) -> None:
        self._books = books

    @property
    def id(self) -> str:
        """What names the session on its server."""
        return self._books.info.id

    @property
    def info(self) -> pb.Session:
        """What the server last said about the session: primitives, warnings, sizes, handles in force, limits."""
        return self._books.info

    @property
    def vertices(self) -> int:
        """Render vertices: the rows of every position array."""
        return sum(primitive.vertex_count for primitive in self._books.info.primitives)

    @property
    def handles(self) -> list[str]:
        """Ids of the handles that this client has set or is going to set."""
        return self._books.handle_ids

    def __repr__(self) -> str:
        info = self._books.info
        name = f" {info.label!r}" if info.label else ""
        end = ", closed" if self._books.closed else ""
        kind = f"{type(self).__module__.rpartition('.')[0]}.{type(self).__name__}"
        ids = self._books.shown_ids
        held = f"handles {ids}" if ids else "no handles"
        return f"<{kind}{name}: {self.vertices} vertices, {held}, revision {info.revision}, id {info.id}{end}>"

    def _repr_html_(self) -> str:
        return preview.card(self._books.info, self._books.shown_ids, None)

    def handle(
        self,
        id: str,
        *,
        translation: Vector | None = None,
        rotation: Vector | None = None,
        rotation_vector: Vector | None = None,
        rotation_degrees: Vector | None = None,
        scale: float | Vector | None = None,
        pivot: Vector | None = None,
        free_rotation: bool = False,
        constrains: Sequence[Literal["position", "rotation", "scale"]] | None = None,
        stiffness: float | None = None,
        rigid: bool = False,
        falloff: tuple[float, Literal["none", "linear", "smooth"]] | None = None,
        targets: bool | Literal["vertex", "area"] = False,
        tangential: float = 0.0,
        guide: Guide | None = None,
        **region: Unpack[RegionFields],
    ) -> None:
        """Adds a handle, or replaces the one of that id.

        The region is one of ``vertices``, ``half_space``, ``sphere``, ``box``, ``capsule``, ``tube``, ``component``,
        ``primitive``, ``weights`` and ``anchors``. Without a pose the handle is an anchor in the rest pose. Where regions overlap, the handle
        that was added later wins. With ``targets`` every vertex has a target of its own, which :class:`pliant.Targets` in a pose
        gives; the ``stiffness``, which it needs, is then per vertex or per area, and ``tangential`` from 0 to 1 leaves the pull along the
        surface out, so that vertices slide in the planes of their targets. With a ``guide``, a :class:`pliant.Curve`,
        :class:`pliant.Lattice` or :class:`pliant.Cage`, its shape gives the targets: :class:`pliant.GuidePose` in a pose.
        """
        with about(f"handle {text('handle', id, 'an id, which is text,')!r}"):
            handle = regions.handle(
                id,
                pose=to_message(Pose(translation, rotation, rotation_vector, scale, pivot, free_rotation, rotation_degrees)),
                constrains=constrains,
                stiffness=stiffness,
                rigid=rigid,
                falloff=falloff,
                targets=targets,
                tangential=tangential,
                guide=guide,
                fields=region,
                count=self.vertices,
            )
        self._books.put(handle)

    def remove_handle(self, id: str) -> None:
        """Takes a handle away."""
        self._books.remove(id)

    def clear_handles(self) -> None:
        """Takes all handles away, also those of other clients."""
        self._books.clear()

    def symmetry_plane(self, normal: Vector, offset: float = 0.0) -> None:
        """Mirrors every handle at the plane normal . x = offset."""
        self._books.limit(symmetry_plane=regions.plane((normal, offset)))

    def region_of_interest(self, **region: Unpack[RegionFields]) -> None:
        """Keeps everything outside the region fixed bit for bit."""
        self._books.limit(region_of_interest=regions.region(region, self.vertices))

    def stiff(
        self,
        *,
        primitives: Sequence[int] = (),
        components: Sequence[int] = (),
        regions_of: Sequence[RegionFields] = (),
        all: bool = False,
        auto: bool = False,
        strength: float | None = None,
    ) -> None:
        """Makes parts move as rigid bodies, with no handle each: those that are listed, all components, or those that look like hard
        parts. What hangs together of each is one part.
        """
        named = [regions.region(fields, self.vertices) for fields in regions_of]
        parts = pb.Stiff(primitives=primitives, components=components, regions=named, all=all, auto=auto, strength=strength)
        self._books.limit(stiff=parts)

    def _check_open(self) -> None:
        if self._books.closed:
            raise errors.SessionLost(f'session "{self.id}" was closed by close(); open the model again')

    def _named(self) -> pb.SessionRequest:
        return pb.SessionRequest(session_id=self.id)


def to_drag(poses: Any, commit: Any, kinds: tuple[type, ...] = (Iterable,)) -> None:
    """Refuses what no drag can follow."""
    if isinstance(poses, (Mapping, str)) or not isinstance(poses, kinds):
        raise TypeError(f"poses: {seen(poses)}, a list or an iterator of dicts from handle ids to poses is allowed")
    if not isinstance(commit, bool) and commit != "last":
        raise ValueError(f'commit: {seen(commit)}, True, False or "last" is allowed')


def recorded(wish: pb.Options) -> pb.Options:
    """A stream's options for a pose that is recorded: solved to the end, and answered whole."""
    record = pb.Options()
    record.CopyFrom(wish)
    for name in ("budget_ms", "progressive", "window"):
        record.ClearField(name)
    record.output.ClearField("changed_only")
    return record
