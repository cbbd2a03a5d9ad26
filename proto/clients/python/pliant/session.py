"""A session: one model on a server, its handles, poses and commits."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import numpy as np
from typing_extensions import Unpack

from . import edits, errors, frames, model, preview
from .animation import AnimateFields, Playing, Rig, order, recording
from .books import Commit, Traffic, commits
from .calls import Calls
from .carried import Carried, carried, model_request, points_request
from .declared import CLOSE_SECONDS, GONE, CommitWish, Declared, recorded, to_drag
from .frames import Floats, Frame, SolvedFrame
from .options import SolveFields, options
from .player import Animation
from .poses import Poses
from .progress import Meter, ProgressLike
from .stream import Stream
from .v1 import pliant_pb2 as pb


class Session(Declared):
    """One open model. Made by :func:`pliant.open`; a ``with`` block closes it at its end.

    Handles are collected here and go to the server together, before the first call that needs them.
    """

    def __init__(self, calls: Calls, info: pb.Session, *, keep: bool, at_close: Callable[[], None] | None) -> None:
        super().__init__(info)
        self._connection = calls
        self._keep = keep
        self._at_close = at_close

    @property
    def _calls(self) -> Calls:
        self._check_open()
        return self._connection

    def apply(self) -> pb.Session:
        """Sends the handles now, if they are not on the server yet; answers the session with the handles in force.

        A handle that the server refuses, such as one that holds nothing, is named by the error and taken back: the session is as
        it was before the handle was added.
        """
        request = self._books.to_send()
        if request is not None:
            try:
                self._books.sent(self._calls.one("SetHandles", request, keyed=True))
            except errors.InvalidArgument as refusal:
                raise self._books.refused(refusal) from None
        return self._books.info

    def solve(self, poses: Poses | None = None, **how: Unpack[SolveFields]) -> Floats:
        """Solves one pose to the tolerance, records it, and answers the positions, (render vertices, 3).

        Handles that are not named keep their last pose.
        """
        return self.solve_frame(poses, **how).positions

    def solve_frame(self, poses: Poses | None = None, **how: Unpack[SolveFields]) -> SolvedFrame:
        """As :meth:`solve`, with normals, errors, times and quality."""
        self.apply()
        return self._solve(poses, options(how))

    def _solve(self, poses: Any, how: pb.Options) -> SolvedFrame:
        request = self._books.solve_request(poses, how)
        parts = self._calls.many("Solve", request, keyed=True)
        frame = frames.solved(frames.whole(parts, self.vertices, changed_only=how.output.HasField("changed_only")))
        self._books.committed(frame, request)
        return frame

    def stream(self, **how: Unpack[SolveFields]) -> Stream:
        """Opens a stream for a drag: poses out, frames in, the newest pose wins."""
        self.apply()
        wish = options(how)
        record = recorded(wish)
        traffic = Traffic(self.id, self.vertices, wish)
        return Stream(self._calls, traffic, lambda poses: self._solve(poses, record))

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
        poses = poses if latest else list(poses) if progress else poses
        total = len(poses) if isinstance(poses, Sequence) else 0
        with Meter(progress, "poses") as tell:
            finals = 0
            for frame in self._drag(iter(poses), commit, latest, how):
                yield frame
                finals += frame.final
                tell(finals, total)

    def _drag(self, poses: Iterator[Poses], commit: CommitWish, latest: bool, how: SolveFields) -> Iterator[Frame]:
        if commit is True:
            for pose in poses:
                yield self.solve_frame(pose, **how)
            return
        with self.stream(**how) as stream:
            if latest:
                yield from _newest(stream, poses)
            else:
                yield from _each(stream, poses, last=commit != "last")
            if commit == "last":
                yield stream.commit()

    def animate(
        self,
        clip: str | int | None = None,
        *,
        bvh: str | Path | bytes | None = None,
        rig: Rig | None = None,
        progress: ProgressLike = False,
        **how: Unpack[AnimateFields],
    ) -> Animation:
        """Drives the model by a clip of its own (`clip`, by name or number; absent, its first) or by a BVH file (`bvh`, a path
        or its bytes), and answers an iterator of the frames. `rig` says which bones the clip's joints drive: a JSON file,
        what it holds, or a ``pb.Rig``; a model's own clip needs none, and of an upright figure a BVH file drives the
        rig that `pliant rig` makes.

        The handles, the shape and the history of the session have no part in it and do not change.
        """
        playing = Playing(self.id, self.vertices, order(clip, rig, how), recording(bvh))
        return Animation(self._calls, playing, self.info.limits.message_bytes, progress)

    def positions(self) -> Floats:
        """The current shape, (render vertices, 3): the rest pose before anything was solved."""
        values = np.frombuffer(self._calls.get(f"/v1/sessions/{self.id}/positions"), "<f4")
        return values.reshape(-1, 3).astype(np.float32)

    def preview(self, width: int = preview.SIZE[0], height: int = preview.SIZE[1]) -> bytes:
        """A small picture of the current shape, a PNG; notebooks show it for a session."""
        return preview.picture(*preview.triangles_of(self.export_bytes("ply")[""]), (width, height))

    def _repr_png_(self) -> bytes | None:
        # A notebook shows what it can: a session that is closed or whose server is away has no picture.
        with suppress(errors.PliantError):
            return self.preview()
        return None

    def _repr_html_(self) -> str:
        return preview.card(self._books.info, self.handles, self._repr_png_())

    def export(self, path: str | Path, format: str = "", *, force: bool = False) -> list[Path]:
        """Writes the model in its current shape; the extension says the format. Answers the paths of the files, all
        of them relative or absolute as `path` is.

        A .gltf comes with its buffers and images, which lie beside it. One of them that would replace a file with other
        bytes raises `FileExistsError` before anything is written, unless `force` is set.
        """
        path = Path(path)
        return model.write(path, self.export_bytes(format or path.suffix.lstrip(".").lower()), force)

    def export_bytes(self, format: str = "") -> dict[str, bytes]:
        """The model in its current shape by file: "" is the main one, others are companions by URI."""
        request = pb.ExportRequest(session_id=self.id, format=format)
        return model.joined(self._calls.many("Export", request))

    def carry(self, points: Any, rotations: Any = None) -> Carried:
        """Carries points of the rest pose, (points, 3), along with the current shape: on the model, in it or around it.

        `rotations` are the axes at the points, quaternions x, y, z, w; absent, those of model space. Nothing changes.
        """
        request = points_request(self.id, points, rotations)
        return carried(self._calls.one("Carry", request))

    def carry_model(self, model: bytes, format: str = "") -> bytes:
        """Carries a model file that stands in the same rest pose, such as a level of detail or a collision hull, and
        answers it in its own format. It has to be one file.
        """
        request = model_request(self.id, model, format)
        return bytes((self._calls.one("Carry", request)).model)

    def edit(
        self, *, on: Literal["current", "rest"] = "current", **operation: Unpack[edits.EditFields]
    ) -> edits.EditResult:
        """Changes the topology: one of ``cut``, ``subdivide``, ``decimate``, ``delete``, ``fill``, ``remesh``,
        ``merge``, ``insert_curve`` and ``weld``.

        Afterwards ``vertices`` and ``info`` are new, and streams have to be opened again.
        """
        request = edits.request(self.id, on, operation, self.vertices)
        self.apply()
        done = edits.result(self._calls.one("Edit", request, keyed=True))
        self._books.edited(self._calls.one("GetSession", self._named()))
        return done

    def undo(self) -> pb.Session:
        """Goes back by one commit; positions return bit for bit."""
        return self._travel("Undo")

    def redo(self) -> pb.Session:
        """Goes forward again by one undone commit."""
        return self._travel("Redo")

    def _travel(self, call: str) -> pb.Session:
        info = self._calls.one(call, self._named(), keyed=True)
        current = self._calls.one("History", self._named()).current
        self._books.travelled(info, current)
        return self._books.info

    def history(self) -> list[Commit]:
        """The commits, oldest first."""
        return commits(self._calls.one("History", self._named()))

    def refresh(self) -> pb.Session:
        """Asks the server about the session, which also renews its expiry."""
        self._books.info = self._calls.one("GetSession", self._named())
        return self._books.info

    def close(self) -> None:
        """Deletes the session on the server, unless it was opened to be kept."""
        try:
            if not self._keep:
                with suppress(*GONE):
                    self._calls.one("DeleteSession", self._named(), patience=CLOSE_SECONDS)
                self._closed = True
        finally:
            self._keep = True
            if self._at_close is not None:
                self._at_close()

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _each(stream: Stream, poses: Iterator[Poses], *, last: bool) -> Iterator[Frame]:
    """Sends one pose after the other, each when the one before is answered; the last one only if `last`."""
    for pose, is_last in with_last(poses):
        if is_last and not last:
            stream.absorb(pose)
            return
        seq = stream.send(pose)
        final = False
        while not final:
            frame = stream.receive()
            yield frame
            final = frame.final and frame.seq == seq


def _newest(stream: Stream, poses: Iterator[Poses]) -> Iterator[Frame]:
    """Sends poses from a thread of their own while frames come."""
    raised: list[BaseException] = []

    def feed() -> None:
        try:
            for pose in poses:
                stream.send(pose)
        except BaseException as error:
            raised.append(error)
        finally:
            stream.finish()

    feeder = threading.Thread(target=feed, name="pliant-poses", daemon=True)
    feeder.start()
    yield from stream
    feeder.join()
    if raised:
        raise raised[0]


def with_last(poses: Iterator[Poses]) -> Iterator[tuple[Poses, bool]]:
    """Every pose, and whether it is the last one."""
    try:
        held = next(poses)
    except StopIteration:
        return
    for pose in poses:
        yield held, False
        held = pose
    yield held, True
