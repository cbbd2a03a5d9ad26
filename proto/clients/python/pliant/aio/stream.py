"""A stream of poses and frames: the newest pose wins, and a lost connection is opened again."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from types import TracebackType
from typing import Any

import grpc

from .. import channel, errors
from ..books import Traffic
from ..frames import Frame, SolvedFrame
from ..poses import Poses
from ..v1 import pliant_pb2 as pb
from .calls import Calls


class Stream:
    """Poses out, frames in. Made by :meth:`Session.stream`.

    Sending never waits. Frames wait here until they are taken, at most the stream's window of them: who takes slowly
    gets fewer frames, not older ones. One thread or task may send while another receives.
    """

    def __init__(
        self, calls: Calls, traffic: Traffic, commit: Callable[[dict[str, pb.HandlePose]], Awaitable[SolvedFrame]]
    ) -> None:
        self._calls = calls
        self._transport = calls.transport
        self._traffic = traffic
        self._commit = commit
        self._news = self._transport.news()
        self._frames: deque[Frame | errors.PliantError] = deque()
        self._failure: errors.PliantError | None = None
        self._closed = False
        self._finished = False
        self._outgoing = self._transport.queue()
        self._call: Any = None
        #: How often a lost connection was opened again.
        self.reconnects = 0
        #: Whether the connection is lost at the moment and looked for; poses wait, the newest goes out when it is back.
        self.lost = False
        self._reader = self._transport.task(self._run(), "pliant-stream")

    def send(self, poses: Poses, *, more: bool = False) -> int:
        """Sends a pose; handles that are not named stay where they are. Answers its number, which its frame carries.

        With `more` it is a part of the next pose, without a frame of its own, so that targets may be larger than a message.
        """
        with self._news:
            self._check()
            self._outgoing.put_nowait(self._traffic.pose(poses, more))
            return self._traffic.seq

    async def receive(self, timeout: float | None = None) -> Frame:
        """Waits for the next frame and takes it.

        Raises what the server said when it rejected a pose (the stream continues), DeadlineExceeded after `timeout`
        seconds. Cancelling the wait, such as by ``asyncio.timeout``, loses no frame.
        """
        with self._news:
            if not await self._transport.wait_for(self._news, lambda: self._frames or self._over, timeout):
                raise errors.DeadlineExceeded(f"no frame came within {timeout} s")
            if not self._frames:
                self._check()
            return self._take(self._frames.popleft())

    def latest(self) -> Frame | None:
        """The newest frame that has come since the last call, without waiting; None when there is none.

        With ``changed_only`` the frames in between are applied to it; only ``changed`` lists less than all of them.
        """
        with self._news:
            if not self._frames:
                self._check()
                return None
            item = self._frames.popleft()
            while isinstance(item, Frame) and self._frames and isinstance(self._frames[0], Frame):
                item = self._frames.popleft()
            return self._take(item)

    async def wait(self, timeout: float | None = None) -> Frame:
        """Waits for the final frame of the newest pose, and takes it with all before it."""
        end = None if timeout is None else time.monotonic() + timeout
        if self._traffic.seq == 0:
            raise errors.FailedPrecondition("no pose was sent on this stream")
        while True:
            frame = await self.receive(None if end is None else max(0.0, end - time.monotonic()))
            if frame.final and frame.seq == self._traffic.seq:
                return frame

    async def commit(self, poses: Poses | None = None) -> SolvedFrame:
        """Records where this stream's handles are, with `poses` on top, exactly once. Solved to the tolerance."""
        with self._news:
            self._check()
            everything = self._traffic.absorb(poses)
        return await self._commit(everything)

    def absorb(self, poses: Poses) -> None:
        """Takes a pose into account without sending it: the next pose or commit carries it."""
        with self._news:
            self._traffic.absorb(poses)

    def finish(self) -> None:
        """Says that no more poses come: iterating ends after the final frame of the newest one."""
        with self._news:
            self._finished = True
            self._news.notify_all()

    async def __aiter__(self) -> AsyncIterator[Frame]:
        """Frames as they come, until :meth:`finish` was called and the newest pose is answered."""
        while True:
            with self._news:
                await self._transport.wait_for(self._news, lambda: self._frames or self._over or self._done, None)
                if not self._frames:
                    if self._done:
                        return
                    self._check()
                item = self._take(self._frames.popleft())
            yield item

    @property
    def _over(self) -> bool:
        return self._closed or self._failure is not None

    @property
    def _done(self) -> bool:
        return self._finished and self._traffic.answered >= self._traffic.seq

    async def close(self) -> None:
        """Ends the stream; a solve under way stops. The session stays."""
        with self._news:
            self._closed = True
            self._outgoing.put_nowait(None)
            if self._call is not None:
                self._call.cancel()
            self._news.notify_all()
        self._reader.cancel()
        await self._transport.ended(self._reader)

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
            self._fail(errors.Internal(f"{type(fault).__name__}: {fault}"))

    def _fail(self, failure: errors.PliantError) -> None:
        with self._news:
            self._failure = failure
            self._news.notify_all()

    async def _read(self) -> None:
        """Reads one connection after the other until the stream is closed or cannot continue."""
        attempts = channel.Attempts(self._calls.settings.patience)
        while True:
            outgoing = self._transport.queue()
            error: errors.PliantError = errors.Unavailable("the server ended the stream")
            call = None
            try:
                with self._news:
                    if self._closed:
                        return
                    self._outgoing = outgoing
                    for message in self._traffic.opening():
                        outgoing.put_nowait(message)
                    self._call = call = self._calls.deform(outgoing)
                async for response in self._transport.answers(call):
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
            with self._news:
                pause = None if self._closed else attempts.again(error)
                self._call = None
                self.lost = True
            if pause is None or not await self._calls.found(pause, attempts.left, lambda: self._closed):
                self._fail(self._calls.reason(attempts.last_word(error)))
                return
            self.reconnects += 1

    def _put(self, response: pb.DeformResponse) -> None:
        with self._news:
            item = self._traffic.take(response)
            if isinstance(item, errors.PliantError) and item.seq is None:
                raise item
            if item is not None:
                self._frames.append(item)
                self._news.notify_all()
