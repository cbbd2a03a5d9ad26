"""A stream of poses and frames on asyncio's event loop."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from types import TracebackType
from typing import Union

import grpc

from .. import channel, errors
from ..books import Traffic
from ..frames import Frame, SolvedFrame
from ..poses import Poses
from ..v1 import pliant_pb2 as pb
from .calls import Calls

_Outgoing = asyncio.Queue[Union[pb.DeformRequest, None]]


class Stream:
    """Poses out, frames in. Made by :meth:`Session.stream`; see :class:`pliant.Stream`."""

    def __init__(
        self, calls: Calls, traffic: Traffic, commit: Callable[[dict[str, pb.HandlePose]], Awaitable[SolvedFrame]]
    ) -> None:
        self._calls = calls
        self._traffic = traffic
        self._commit = commit
        self._news = asyncio.Event()
        self._frames: deque[Frame | errors.PliantError] = deque()
        self._failure: errors.PliantError | None = None
        self._closed = False
        self._finished = False
        self._outgoing: _Outgoing = asyncio.Queue()
        #: How often a lost connection was opened again.
        self.reconnects = 0
        #: Whether the connection is lost at the moment and looked for; poses wait, the newest goes out when it is back.
        self.lost = False
        self._reader = asyncio.create_task(self._run())

    def send(self, poses: Poses) -> int:
        """Sends a pose; handles that are not named stay where they are. Answers its number, which its frame carries."""
        self._check()
        self._outgoing.put_nowait(self._traffic.pose(poses))
        return self._traffic.seq

    async def receive(self) -> Frame:
        """Waits for the next frame and takes it. Raises what the server said when it refused a pose.

        Cancelling the wait, such as by ``asyncio.timeout``, loses no frame.
        """
        while not self._frames:
            self._check()
            self._news.clear()
            await self._news.wait()
        return self._take(self._frames.popleft())

    def latest(self) -> Frame | None:
        """The newest frame that has come since the last call, without waiting; None when there is none."""
        if not self._frames:
            self._check()
            return None
        item = self._frames.popleft()
        while isinstance(item, Frame) and self._frames and isinstance(self._frames[0], Frame):
            item = self._frames.popleft()
        return self._take(item)

    async def wait(self) -> Frame:
        """Waits for the final frame of the newest pose, and takes it with all before it."""
        if self._traffic.seq == 0:
            raise errors.FailedPrecondition("no pose was sent on this stream")
        while True:
            frame = await self.receive()
            if frame.final and frame.seq == self._traffic.seq:
                return frame

    async def commit(self, poses: Poses | None = None) -> SolvedFrame:
        """Records where this stream's handles are, with `poses` on top, exactly once. Solved to the tolerance."""
        self._check()
        return await self._commit(self._traffic.absorb(poses))

    def absorb(self, poses: Poses) -> None:
        """Takes a pose into account without sending it: the next pose or commit carries it."""
        self._traffic.absorb(poses)

    def finish(self) -> None:
        """Says that no more poses come: iterating ends after the final frame of the newest one."""
        self._finished = True
        self._news.set()

    async def __aiter__(self) -> AsyncIterator[Frame]:
        """Frames as they come, until :meth:`finish` was called and the newest pose is answered."""
        while True:
            while not self._frames:
                if self._finished and self._traffic.answered >= self._traffic.seq:
                    return
                self._check()
                self._news.clear()
                await self._news.wait()
            yield self._take(self._frames.popleft())

    async def close(self) -> None:
        """Ends the stream; a solve under way stops. The session stays."""
        self._closed = True
        self._news.set()
        self._reader.cancel()
        await asyncio.gather(self._reader, return_exceptions=True)

    async def __aenter__(self) -> Stream:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    def _check(self) -> None:
        if self._closed:
            raise errors.FailedPrecondition("the stream is closed")
        if self._failure is not None:
            raise self._failure

    def _take(self, item: Frame | errors.PliantError) -> Frame:
        if isinstance(item, errors.PliantError):
            raise item
        # Frames up to this one may leave the server's window.
        self._outgoing.put_nowait(pb.DeformRequest(ack=pb.Ack(seq=item.seq)))
        return item

    async def _run(self) -> None:
        try:
            await self._read()
        except Exception as fault:
            # A defect of this package: who waits for a frame is told, and does not wait for ever.
            self._failure = errors.Internal(f"{type(fault).__name__}: {fault}")
            self._news.set()

    async def _read(self) -> None:
        """Reads one connection after the other until the stream is closed or cannot continue."""
        attempts = channel.Attempts(self._calls.settings.patience)
        while True:
            outgoing: _Outgoing = asyncio.Queue()
            self._outgoing = outgoing
            for message in self._traffic.opening():
                outgoing.put_nowait(message)
            error: errors.PliantError = errors.Unavailable("the server ended the stream")
            call = None
            try:
                call = self._calls.deform(_until_none(outgoing))
                async for response in call:
                    attempts = channel.Attempts(self._calls.settings.patience, resuming=True)
                    self.lost = False
                    self._put(response)
            except grpc.RpcError as failed:
                error = self._calls.fault(failed)
            except errors.PliantError as broken:
                error = broken
            finally:
                if call is not None:
                    call.cancel()
                outgoing.put_nowait(None)
            pause = attempts.again(error)
            self.lost = True
            if pause is None or not await self._calls.found(pause, attempts.left):
                self._failure = self._calls.reason(attempts.last_word(error))
                self._news.set()
                return
            self.reconnects += 1

    def _put(self, response: pb.DeformResponse) -> None:
        item = self._traffic.take(response)
        if isinstance(item, errors.PliantError) and item.seq is None:
            raise item
        if item is not None:
            self._frames.append(item)
            self._news.set()


async def _until_none(queue: _Outgoing) -> AsyncIterator[pb.DeformRequest]:
    while (message := await queue.get()) is not None:
        yield message
