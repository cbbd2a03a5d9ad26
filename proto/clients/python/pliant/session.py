"""A session: one model on a server, its handles, poses and commits."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING

from typing_extensions import Unpack

from . import aio, errors, preview
from .blocking import Face, blocking, iterating, plain
from .declared import CommitWish, Declared, to_drag
from .frames import Frame
from .options import SolveFields
from .player import Animation
from .poses import Poses
from .progress import ProgressLike
from .stream import Stream

if TYPE_CHECKING:
    from .notebook import Widget


class Session(Face, Declared):
    """One open model. Made by :func:`pliant.open`; a ``with`` block closes it at its end.

    Handles are collected here and go to the server together, before the first call that needs them.
    """

    _core: aio.Session

    def __init__(self, core: aio.Session) -> None:
        super().__init__(core._books)
        self._core = core

    apply = blocking(aio.Session.apply)
    solve = blocking(aio.Session.solve)
    solve_frame = blocking(aio.Session.solve_frame)
    stream = blocking(aio.Session.stream, Stream)
    animate = plain(aio.Session.animate, Animation)
    positions = blocking(aio.Session.positions)
    triangles = blocking(aio.Session.triangles)
    to_trimesh = blocking(aio.Session.to_trimesh)
    export = blocking(aio.Session.export)
    export_bytes = blocking(aio.Session.export_bytes)
    _preview_bytes = blocking(aio.Session._preview_bytes)
    carry = blocking(aio.Session.carry)
    carry_model = blocking(aio.Session.carry_model)
    crossings = blocking(aio.Session.crossings)
    make_rig = blocking(aio.Session.make_rig)
    edit = blocking(aio.Session.edit)
    adopt = blocking(aio.Session.adopt)
    wrap = blocking(aio.Session.wrap)
    transfer = blocking(aio.Session.transfer)
    undo = blocking(aio.Session.undo)
    redo = blocking(aio.Session.redo)
    history = blocking(aio.Session.history)
    refresh = blocking(aio.Session.refresh)
    close = blocking(aio.Session.close)
    _drag = iterating(aio.Session.drag)

    def drag(
        self,
        poses: Iterable[Poses],
        *,
        commit: CommitWish = False,
        latest: bool = False,
        progress: ProgressLike = False,
        **how: Unpack[SolveFields],
    ) -> Iterator[Frame]:
        """Drags handles along `poses` and yields the frames.

        Every pose is answered before the next one is taken, by one frame, or with ``progressive`` by several of which
        the last is ``final``. With ``latest`` poses are taken as fast as they come (from an iterator that waits for a
        mouse, say) and only the newest is solved. ``commit=True`` records every pose, ``commit="last"`` the last one.
        """
        to_drag(poses, commit)
        poses = list(poses) if progress and not latest else poses
        yield from self._drag(poses, commit=commit, latest=latest, progress=progress, **how)

    def preview(
        self, width: int = preview.SIZE[0], height: int = preview.SIZE[1], view: tuple[float, float] = preview.VIEW
    ) -> bytes:
        """A small picture of the current shape, a PNG; notebooks show it for a session. `view` is in degrees: around the model from its
        front (+z), and above the horizon."""
        return preview.picture(*preview.triangles_of(self._preview_bytes()), (width, height), view)

    def widget(self, *, height: int = 420, free_rotation: bool = True) -> Widget:
        """The mesh in a notebook, with a dot for each handle that the pointer drags; letting go records the pose. It needs anywidget:
        ``pip install 'pliant[notebook]'``.

        `height` is in pixels. With `free_rotation` a handle that is moved turns freely, so that what it hangs on bends into an arc; handles
        that constrain less than position and rotation cannot.
        """
        from .notebook import show

        return show(self, height=height, free_rotation=free_rotation)

    def _repr_png_(self) -> bytes | None:
        # A notebook shows what it can: a session that is closed or whose server is away has no picture.
        with suppress(errors.PliantError):
            return self.preview()
        return None

    def _repr_html_(self) -> str:
        return preview.card(self._books.info, self.handles, self._repr_png_())
