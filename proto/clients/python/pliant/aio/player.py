"""An animation as an iterator of its frames."""

from __future__ import annotations

from collections.abc import AsyncIterator
from types import TracebackType
from typing import Any

import grpc

from .. import channel, errors
from ..animation import AnimatedFrame, Playing
from ..progress import Meter, ProgressLike
from ..v1 import pliant_pb2 as pb
from .calls import Calls


class Animation:
    """The frames of an animation, in order and none left out. Made by :meth:`Session.animate`.

    The server solves at most a window of frames ahead. Where the connection is lost, it continues with the frame after the
    last one. Closing it, or the end of a ``with`` block, stops the server's work.
    """

    def __init__(self, calls: Calls, playing: Playing, message_bytes: int, progress: ProgressLike) -> None:
        self._calls = calls
        self._playing = playing
        self._message_bytes = message_bytes
        self._meter = Meter(progress, "frames")
        self._outgoing: Any = None
        self._call: Any = None
        self._taken = 0
        #: Whether it was closed.
        self.closed = False
        #: How often a lost connection was opened again.
        self.reconnects = 0
        self._open()
        self._frames = self._run()

    @property
    def report(self) -> pb.AnimationReport | None:
        """Totals, warnings and what the handles of the rig hold; None until all frames have come."""
        return self._playing.report

    @property
    def stage(self) -> tuple[str, float]:
        """What is under way before the first frame, and how much of it is done."""
        return self._playing.stage

    def __aiter__(self) -> Animation:
        return self

    async def __anext__(self) -> AnimatedFrame:
        frame = await self._frames.__anext__()
        self._taken += 1
        self._meter(self._taken, self._playing.total or frame.count)
        return frame

    async def close(self) -> None:
        """Stops the animation; the session stays."""
        self.closed = True
        self._outgoing.put_nowait(None)
        self._call.cancel()
        self._meter.__exit__(None, None, None)

    async def __aenter__(self) -> Animation:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    def _open(self) -> None:
        self._outgoing = self._calls.transport.queue()
        for request in self._playing.opening(self._message_bytes):
            self._outgoing.put_nowait(request)
        self._call = self._calls.animate(self._outgoing)

    async def _run(self) -> AsyncIterator[AnimatedFrame]:
        attempts = channel.Attempts(self._calls.settings.patience)
        while True:
            error: errors.PliantError = errors.Unavailable("the server ended the animation")
            try:
                async for part in self._calls.transport.answers(self._call):
                    attempts = channel.Attempts(self._calls.settings.patience, resuming=True)
                    frame = self._playing.take(part)
                    self._meter.stage(self._playing.under_way)
                    if frame is not None:
                        yield frame
                        # Who asks for the next one has this one.
                        self._outgoing.put_nowait(pb.AnimateRequest(ack=pb.Ack(seq=frame.seq)))
            except grpc.RpcError as failed:
                error = self._calls.fault(failed)
            if self._playing.complete() or self.closed:
                return
            pause = attempts.again(error)
            if pause is None or not await self._calls.found(pause, attempts.left, lambda: self.closed):
                raise self._calls.reason(attempts.last_word(error))
            self.reconnects += 1
            self._outgoing.put_nowait(None)
            self._open()
