"""A session on asyncio's event loop."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterable, AsyncIterator, Awaitable, Callable, Iterable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Union

import numpy as np
from typing_extensions import Unpack

from .. import edits, errors, frames, model
from ..animation import AnimateFields, Playing, Rig, order, recording
from ..books import Commit, Traffic, commits
from ..carried import Carried, carried, model_request, points_request
from ..declared import CLOSE_SECONDS, GONE, CommitWish, Declared, recorded, to_drag
from ..frames import Floats, Frame, SolvedFrame
from ..options import SolveFields, options
from ..poses import Poses
from ..progress import Meter, ProgressLike
from ..v1 import pliant_pb2 as pb
from .calls import Calls
from .player import Animation
from .stream import Stream


class Session(Declared):
    """One open model. Made by :func:`pliant.aio.open`; see :class:`pliant.Session`."""

    def __init__(
        self, calls: Calls, info: pb.Session, *, keep: bool, at_close: Callable[[], Awaitable[None]] | None
    ) -> None:
        super().__init__(info)
        self._connection = calls
        self._keep = keep
        self._at_close = at_close

    @property
    def _calls(self) -> Calls:
        self._check_open()
        return self._connection

    async def apply(self) -> pb.Session:
        """Sends the handles now, if they are not on the server yet; see :meth:`pliant.Session.apply`."""
        request = self._books.to_send()
        if request is not None:
            try:
                self._books.sent(await self._calls.one("SetHandles", request, keyed=True))
            except errors.InvalidArgument as refusal:
                raise self._books.refused(refusal) from None
        return self._books.info

    async def solve(self, poses: Poses | None = None, **how: Unpack[SolveFields]) -> Floats:
        """Solves one pose to the tolerance, records it, and answers the positions, (render vertices, 3)."""
        return (await self.solve_frame(poses, **how)).positions

    async def solve_frame(self, poses: Poses | None = None, **how: Unpack[SolveFields]) -> SolvedFrame:
        """As :meth:`solve`, with normals, errors, times and quality."""
        await self.apply()
        return await self._solve(poses, options(how))

    async def _solve(self, poses: Any, how: pb.Options) -> SolvedFrame:
        request = self._books.solve_request(poses, how)
        parts = await self._calls.many("Solve", request, keyed=True)
        frame = frames.solved(frames.whole(parts, self.vertices, changed_only=how.output.HasField("changed_only")))
        self._books.committed(frame, request)
        return frame

    async def stream(self, **how: Unpack[SolveFields]) -> Stream:
        """Opens a stream for a drag: poses out, frames in, the newest pose wins."""
        await self.apply()
        wish = options(how)
        record = recorded(wish)
        traffic = Traffic(self.id, self.vertices, wish)
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
        """Drags handles along `poses`, which may come asynchronously; see :meth:`pliant.Session.drag`."""
        to_drag(poses, commit, (Iterable, AsyncIterable))
        total = len(poses) if isinstance(poses, (list, tuple)) else 0
        with Meter(progress, "poses") as tell:
            finals = 0
            async for frame in self._drag(_asynchronous(poses), commit, latest, how):
                yield frame
                finals += frame.final
                tell(finals, total)

    async def _drag(
        self, poses: AsyncIterator[Poses], commit: CommitWish, latest: bool, how: SolveFields
    ) -> AsyncIterator[Frame]:
        if commit is True:
            async for pose in poses:
                yield await self.solve_frame(pose, **how)
            return
        async with await self.stream(**how) as stream:
            sent = _newest(stream, poses) if latest else _each(stream, poses, last=commit != "last")
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
        """Drives the model by a clip and answers an asynchronous iterator of the frames; see :meth:`pliant.Session.animate`."""
        playing = Playing(self.id, self.vertices, order(clip, rig, how), recording(bvh))
        return Animation(self._calls, playing, self.info.limits.message_bytes, progress)

    async def positions(self) -> Floats:
        """The current shape, (render vertices, 3): the rest pose before anything was solved."""
        values = np.frombuffer(await self._calls.get(f"/v1/sessions/{self.id}/positions"), "<f4")
        return values.reshape(-1, 3).astype(np.float32)

    async def export(self, path: str | Path, format: str = "", *, force: bool = False) -> list[Path]:
        """Writes the model in its current shape; see :meth:`pliant.Session.export`."""
        path = Path(path)
        files = await self.export_bytes(format or path.suffix.lstrip(".").lower())
        return await asyncio.to_thread(model.write, path, files, force)

    async def export_bytes(self, format: str = "") -> dict[str, bytes]:
        """The model in its current shape by file: "" is the main one, others are companions by URI."""
        request = pb.ExportRequest(session_id=self.id, format=format)
        return model.joined(await self._calls.many("Export", request))

    async def carry(self, points: Any, rotations: Any = None) -> Carried:
        """Carries points along with the current shape; see :meth:`pliant.Session.carry`."""
        request = points_request(self.id, points, rotations)
        return carried(await self._calls.one("Carry", request))

    async def carry_model(self, model: bytes, format: str = "") -> bytes:
        """Carries a model file along with the current shape; see :meth:`pliant.Session.carry_model`."""
        request = model_request(self.id, model, format)
        return bytes((await self._calls.one("Carry", request)).model)

    async def edit(
        self, *, on: Literal["current", "rest"] = "current", **operation: Unpack[edits.EditFields]
    ) -> edits.EditResult:
        """Changes the topology; see :meth:`pliant.Session.edit`."""
        request = edits.request(self.id, on, operation, self.vertices)
        await self.apply()
        done = edits.result(await self._calls.one("Edit", request, keyed=True))
        self._books.edited(await self._calls.one("GetSession", self._named()))
        return done

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
                self._closed = True
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
            await asyncio.sleep(0)


async def _each(stream: Stream, poses: AsyncIterator[Poses], *, last: bool) -> AsyncIterator[Frame]:
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


async def _newest(stream: Stream, poses: AsyncIterator[Poses]) -> AsyncIterator[Frame]:
    """Sends poses from a task of their own while frames come."""

    async def feed() -> None:
        try:
            async for pose in poses:
                stream.send(pose)
        finally:
            stream.finish()

    feeder = asyncio.create_task(feed())
    try:
        async for frame in stream:
            yield frame
        await feeder
    finally:
        feeder.cancel()
