"""A session: one model on a server, its handles, poses and commits."""

from __future__ import annotations

import os
from collections.abc import (
    AsyncGenerator,
    AsyncIterable,
    AsyncIterator,
    Awaitable,
    Callable,
    Coroutine,
    Iterable,
    Mapping,
    Sequence,
)
from contextlib import aclosing, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, TypeVar, Union

import numpy as np
import numpy.typing as npt
from typing_extensions import Unpack

from .. import edits, errors, frames, model, preview, transfers
from ..animation import AnimateFields, Playing, Rig, order, recording
from ..books import Books, Commit, Traffic, commits
from ..carried import Carried, carried, model_request, points_request
from ..declared import CLOSE_SECONDS, GONE, CommitWish, Declared, recorded, to_drag
from ..frames import Frame, Positions, SolvedFrame, in_model_space
from ..model import warn_of
from ..options import SolveFields, options
from ..poses import Poses
from ..progress import Meter, ProgressLike
from ..transport import OnLoop
from ..values import array, text, whole
from ..v1 import pliant_pb2 as pb
from .calls import Calls
from .player import Animation
from .stream import Stream

_T = TypeVar("_T")

#: Seconds between looks at how far the server is.
_GLANCE = 0.25


class Session(Declared):
    """One open model. Made by :func:`pliant.aio.open`; an ``async with`` block closes it at its end.

    Handles are collected here and go to the server together, before the first call that needs them.
    """

    def __init__(
        self, calls: Calls, info: pb.Session, *, keep: bool, at_close: Callable[[], Awaitable[None]] | None
    ) -> None:
        super().__init__(Books(info))
        self._connection = calls
        self._keep = keep
        self._at_close = at_close

    @property
    def _calls(self) -> Calls:
        self._check_open()
        return self._connection

    async def apply(self) -> pb.Session:
        """Sends the handles now, if they are not on the server yet; answers the session with the handles in force.

        A handle that the server refuses, such as one that holds nothing, is named by the error and taken back: the session is as
        it was before the handle was added.
        """
        request = self._books.to_send()
        if request is not None:
            try:
                self._books.sent(await self._calls.one("SetHandles", request, keyed=True))
            except errors.InvalidArgument as refusal:
                raise self._books.refused(refusal) from None
        return self._books.info

    async def solve(self, poses: Poses | None = None, **how: Unpack[SolveFields]) -> Positions:
        """Solves one pose to the tolerance, records it, and answers the positions, (render vertices, 3).

        Handles that are not named keep their last pose.
        """
        return (await self.solve_frame(poses, **how)).positions

    async def solve_frame(self, poses: Poses | None = None, **how: Unpack[SolveFields]) -> SolvedFrame:
        """As :meth:`solve`, with normals, errors, times and quality."""
        await self.apply()
        return await self._solve(poses, options(how))

    async def _solve(self, poses: Any, how: pb.Options) -> SolvedFrame:
        request = self._books.solve_request(poses, how)
        parts = await self._calls.commit(request)
        frame = frames.solved(frames.whole(parts, self.vertices, changed_only=how.output.HasField("changed_only")))
        self._books.committed(frame, request)
        return frame

    async def stream(self, **how: Unpack[SolveFields]) -> Stream:
        """Opens a stream for a drag: poses out, frames in, the newest pose wins."""
        await self.apply()
        wish = options(how)
        record = recorded(wish)
        traffic = Traffic(self.info, self.vertices, wish)
        return Stream(self._calls, traffic, lambda poses: self._solve(poses, record))

    async def drag(
        self,
        poses: Union[Iterable[Poses], AsyncIterable[Poses]],
        *,
        commit: CommitWish = False,
        latest: bool = False,
        progress: ProgressLike = False,
        **how: Unpack[SolveFields],
    ) -> AsyncIterator[Frame]:
        """Drags handles along `poses` and yields the frames.

        Every pose is answered before the next one is taken, by one frame, or with ``progressive`` by several of which
        the last is ``final``. With ``latest`` poses are taken as fast as they come (from an iterator that waits for a
        mouse, say) and only the newest is solved. ``commit=True`` records every pose, ``commit="last"`` the last one.
        """
        to_drag(poses, commit, (Iterable, AsyncIterable))
        total = len(poses) if isinstance(poses, Sequence) else 0
        with Meter(progress, "poses") as tell:
            finals = 0
            async with aclosing(self._drag(_asynchronous(poses), commit, latest, how)) as dragged:
                async for frame in dragged:
                    yield frame
                    finals += frame.final
                    tell(finals, total)

    async def _drag(
        self, poses: AsyncIterator[Poses], commit: CommitWish, latest: bool, how: SolveFields
    ) -> AsyncGenerator[Frame, None]:
        if commit is True:
            async for pose in poses:
                yield await self.solve_frame(pose, **how)
            return
        async with await self.stream(**how) as stream:
            sent = _newest(stream, poses, stream._transport) if latest else _each(stream, poses, last=commit != "last")
            async with aclosing(sent):
                async for frame in sent:
                    yield frame
            if commit == "last":
                yield await stream.commit()

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

    async def positions(self) -> Positions:
        """The current shape, (render vertices, 3): the rest pose before anything was solved. It is float64 where the session has an
        origin (`info.origin`), else float32."""
        values = np.frombuffer(await self._calls.get(f"/v1/sessions/{self.id}/positions"), "<f4")
        return in_model_space(values.reshape(-1, 3).astype(np.float32), self.info.origin)

    async def triangles(self) -> npt.NDArray[np.int64]:
        """The triangles, (triangles, 3) numbers of rows of :meth:`positions`. They stay the same until an edit."""
        points, triangles = preview.triangles_of(await self._preview_bytes())
        if len(points) == self.vertices:
            return triangles
        # The file is of the primitives with triangles: points, lines and the centres of splats are left out.
        drawn = [p for p in self.info.primitives if p.index_count > 0]
        rows = np.concatenate([np.arange(p.first_vertex, p.first_vertex + p.vertex_count) for p in drawn])
        if len(points) != len(rows):
            raise errors.Internal(f"the triangles are of {len(points)} vertices, the session has {self.vertices}")
        return rows[triangles]

    async def to_trimesh(self) -> Any:
        """The model in its current shape as a `trimesh.Trimesh`, whose vertices are the rows of :meth:`positions`. It needs trimesh."""
        import trimesh

        return trimesh.Trimesh(await self.positions(), await self.triangles(), process=False)

    async def export(self, path: str | Path, format: str = "", *, force: bool = False) -> list[Path]:
        """Writes the model in its current shape; the extension says the format. Answers the paths of the files, all
        of them relative or absolute as `path` is.

        A .gltf comes with its buffers and images, which lie beside it. One of them that would replace a file with other
        bytes raises `FileExistsError` before anything is written, unless `force` is set. What the files do not hold is a
        warning of Python (`UserWarning`).
        """
        path = Path(path)
        files = await self.export_bytes(format or path.suffix.lstrip(".").lower())
        return await self._calls.transport.aside(model.write, path, files, force)

    async def export_bytes(self, format: str = "") -> dict[str, bytes]:
        """The model in its current shape by file: "" is the main one, others are companions by URI.

        What the files do not hold is a warning of Python (`UserWarning`), as of :meth:`export`.
        """
        chunks = await self._exported(format)
        warn_of(chunks)
        return model.joined(chunks)

    async def _preview_bytes(self) -> bytes:
        """The surface in its current shape, as `preview.triangles_of` reads it."""
        return model.joined(await self._exported(preview.surface_format(self.info.model.format)))[""]

    async def _exported(self, format: str) -> list[pb.Chunk]:
        request = pb.ExportRequest(session_id=self.id, format=format)
        return list(await self._calls.many("Export", request))

    async def carry(self, points: Any, rotations: Any = None) -> Carried:
        """Carries points of the rest pose, (points, 3), along with the current shape: on the model, in it or around it.

        `rotations` are the axes at the points, quaternions x, y, z, w; absent, those of model space. Nothing changes.
        """
        request = points_request(self.id, points, rotations)
        return carried(await self._calls.one("Carry", request))

    async def carry_model(self, model: bytes, format: str = "") -> bytes:
        """Carries a model file that stands in the same rest pose, such as a level of detail, a collision hull or Gaussian
        splats (`format` is also "splat" or "spz"), and answers it in its own format. It has to be one file.

        What of it may not fit is a warning of Python (`UserWarning`), as of :meth:`export`.
        """
        answer = await self._calls.one("Carry", model_request(self.id, model, format))
        warn_of([answer])
        return bytes(answer.model)

    async def crossings(self, limit: int = 0, *, pairs: bool = False) -> pb.CrossingsResponse:
        """The triangles of the current shape that cross others: ``triangles`` that cross one that they do not cross in the
        rest shape, and ``at_rest``; at most `limit` in each list (0: 100,000), ``total`` says how many there are.

        With `pairs` also which two cross, where, how deep, and whether handles hold both.
        """
        request = pb.CrossingsRequest(session_id=self.id, limit=whole("limit", limit), pairs=pairs)
        answer: pb.CrossingsResponse = await self._calls.one("Crossings", request)
        return answer

    async def make_rig(
        self,
        bvh: bytes | None = None,
        *,
        preset: str | None = None,
        joints: Mapping[str, Any] | None = None,
        up: str = "",
        front: str = "",
    ) -> pb.MakeRigResponse:
        """The rig that a recording (the bytes of a BVH file, of which the first three frames are enough) or a preset
        (``cmu``, ``mixamo``) drives the model by, and how sure its joints are. Nothing changes.

        `joints` are places by name, x, y, z: they stay, and joints that depend on them follow. `up` and `front` say how the
        figure stands, such as ``z`` and ``-y``.
        """
        request = pb.MakeRigRequest(session_id=self.id, up=text("up", up), front=text("front", front))
        if bvh is not None:
            request.bvh = bytes(bvh)
        elif preset is not None:
            request.preset = text("preset", preset)
        for name, place in (joints or {}).items():
            request.joints[name].at.extend(array(f"joints[{name!r}]", place).astype(float).ravel())
        answer: pb.MakeRigResponse = await self._calls.one("MakeRig", request)
        return answer

    async def _watched(self, call: Coroutine[Any, Any, _T], progress: ProgressLike, what: str) -> _T:
        """Waits for a call on the session, and reports how far the server is with it."""
        if not progress:
            return await call
        transport, over = self._calls.transport, False
        news = transport.news()

        async def watch() -> None:
            while True:
                with news:
                    if await transport.wait_for(news, lambda: over, _GLANCE):
                        return
                info = await self._calls.one("GetSession", self._named(), patience=0)
                if info.HasField("work") and info.work.stage:
                    tell.stage(info.work.stage)
                    tell(round(100 * info.work.fraction), 100)

        with Meter(progress, what, unit="%") as tell:
            task = transport.task(watch(), f"pliant {what}")
            try:
                return await call
            finally:
                with news:
                    over = True
                    news.notify_all()
                await transport.ended(task)

    async def edit(
        self,
        *,
        on: Literal["current", "rest"] = "current",
        progress: ProgressLike = False,
        **operation: Unpack[edits.EditFields],
    ) -> edits.EditResult:
        """Changes the topology: one of ``cut``, ``subdivide``, ``decimate``, ``delete``, ``fill``, ``remesh``, ``smooth``,
        ``merge``, ``wrap``, ``unintersect``, ``insert_curve``, ``weld``, ``clean`` and ``adopt``.

        Afterwards ``vertices`` and ``info`` are new, and streams have to be opened again. `progress` is True for a bar, or is called
        with percent done and 100; one that has a method ``stage`` gets the name of each stage.
        """
        request = edits.request(self.id, on, operation, self.vertices, self.info.origin)
        await self.apply()
        call = self._calls.one("Edit", request, keyed=True)
        done = edits.result(await self._watched(call, progress, "edit"))
        self._books.edited(await self._calls.one("GetSession", self._named()))
        return done

    async def adopt(
        self, positions: npt.ArrayLike | None = None, *, on: Literal["current", "rest"] = "current"
    ) -> edits.EditResult:
        """Makes a shape the rest pose, from which poses go on: the current one, or (n, 3) `positions` of all vertices or of those that
        are no passenger's, in model space. They hold bit for bit (32 bits, relative to an origin where there is one); rig, skins,
        morph targets and passengers follow. One commit, in parts where it is large.
        """
        requests = edits.adoptions(self.info, on, positions, self.vertices)
        await self.apply()
        for request in requests:
            answer = await self._calls.one("Edit", request, keyed=True)
        self._books.edited(await self._calls.one("GetSession", self._named()))
        return edits.result(answer)

    async def wrap(
        self,
        /,
        target: str | os.PathLike[str] | bytes | None = None,
        *,
        session: str = "",
        on: Literal["current", "rest"] = "current",
        progress: ProgressLike = False,
        **settings: Any,
    ) -> edits.EditResult:
        """Moves all vertices so that the surface lies on that of `target`, a file or its bytes, or on the shape of another
        session; topology, texture coordinates, rig and morph targets follow. One commit. `settings` are those of
        ``edit(wrap=...)``: ``landmarks``, ``mask``, ``in_place``, ``format``. ``wrap`` of the result says how well it lies;
        `progress` is as in :meth:`edit`.
        """
        if (target is None) == (not session):
            raise TypeError("wrap: a file or a session to wrap onto is needed, and only one of them")
        source: dict[str, Any] = {"session": session} if session else {"model": target}
        return await self.edit(on=on, progress=progress, wrap={**source, **settings})  # type: ignore[typeddict-item]

    async def transfer(
        self,
        /,
        source: transfers.ModelLike | None = None,
        *,
        session: str = "",
        shape: transfers.ModelLike | None = None,
        fit: bool = False,
        clearance: float | None = None,
        landmarks: Sequence[Any] = (),
        format: str = "",
        shape_format: str = "",
        output: str = "",
        progress: ProgressLike = False,
    ) -> transfers.Transferred:
        """The model with the blend shapes of `source`, a file or its bytes, or of another session; with `shape`, the source in
        another shape, the model in the shape that it takes on by it. Nothing changes.

        With `fit`, this model is an outfit of `source`, a body, and comes as it fits another body, which `shape` is: outside of it, and
        as far off as from the first, up to `clearance`.

        `landmarks` are pairs (own, source) of vertex numbers or points (x, y, z); with `fit`, pairs (first body, second body).
        `progress` is as in :meth:`edit`.
        """
        formats = (format, shape_format, output)
        request = transfers.request(self.id, source, session, shape, landmarks, formats, fit, clearance)
        chunks = list(await self._watched(self._calls.many("Transfer", request), progress, "transfer"))
        model.warn_of(chunks)
        return transfers.transferred(chunks)

    async def undo(self) -> pb.Session:
        """Goes back by one commit; positions return bit for bit."""
        return await self._travel("Undo")

    async def redo(self) -> pb.Session:
        """Goes forward again by one undone commit."""
        return await self._travel("Redo")

    async def _travel(self, call: str) -> pb.Session:
        info = await self._calls.one(call, self._named(), keyed=True)
        history = await self._calls.one("History", self._named())
        self._books.travelled(info, history.current)
        return self._books.info

    async def history(self) -> list[Commit]:
        """The commits, oldest first."""
        return commits(await self._calls.one("History", self._named()))

    async def refresh(self) -> pb.Session:
        """Asks the server about the session, which also renews its expiry."""
        self._books.info = await self._calls.one("GetSession", self._named())
        return self._books.info

    async def close(self) -> None:
        """Deletes the session on the server, unless it was opened to be kept."""
        try:
            if not self._keep:
                with suppress(*GONE):
                    await self._calls.one("DeleteSession", self._named(), patience=CLOSE_SECONDS)
                self._books.closed = True
        finally:
            self._keep = True
            if self._at_close is not None:
                await self._at_close()

    async def __aenter__(self) -> Session:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()


async def _asynchronous(poses: Union[Iterable[Poses], AsyncIterable[Poses]]) -> AsyncIterator[Poses]:
    if isinstance(poses, AsyncIterable):
        async for pose in poses:
            yield pose
    else:
        for pose in poses:
            yield pose


async def _each(stream: Stream, poses: AsyncIterator[Poses], *, last: bool) -> AsyncGenerator[Frame, None]:
    """Sends one pose after the other, each when the one before is answered; the last one only if `last`."""
    held: Poses | None = None
    async for pose in poses:
        if held is not None:
            async for frame in _answers(stream, held):
                yield frame
        held = pose
    if held is not None and last:
        async for frame in _answers(stream, held):
            yield frame
    elif held is not None:
        stream.absorb(held)


async def _answers(stream: Stream, poses: Poses) -> AsyncIterator[Frame]:
    seq = stream.send(poses)
    final = False
    while not final:
        frame = await stream.receive()
        yield frame
        final = frame.final and frame.seq == seq


async def _newest(stream: Stream, poses: AsyncIterator[Poses], transport: OnLoop) -> AsyncGenerator[Frame, None]:
    """Sends poses from a task of their own, on a blocking transport a thread, while frames come."""

    async def feed() -> None:
        try:
            async for pose in poses:
                stream.send(pose)
                await transport.sleep(0)
        finally:
            stream.finish()

    feeder = transport.task(feed(), "pliant-poses")
    try:
        async for frame in stream:
            yield frame
        raised = await transport.ended(feeder)
        if raised is not None:
            raise raised
    finally:
        feeder.cancel()
