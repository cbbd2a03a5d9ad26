"""A stream of poses and frames: the newest pose wins, and a lost connection is opened again."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from queue import SimpleQueue
from types import TracebackType
from typing import Union

import grpc

from . import channel, errors
from .books import Traffic
from .calls import Calls
from .frames import Frame, SolvedFrame
from .poses import Poses
from .v1 import pliant_pb2 as pb

_Outgoing = SimpleQueue[Union[pb.DeformRequest, None]]


class Stream:
    """Poses out, frames in. Made by :meth:`Session.stream`.

    Sending never waits. Frames wait here until they are taken, at most the stream's window of them: who takes slowly
    gets fewer frames, not older ones. One thread may send while another receives.
    """

    def __init__(self, calls: Calls, traffic: Traffic, commit: Callable[[dict[str, pb.HandlePose]], SolvedFrame]) -> None:
        self._calls = calls
        self._traffic = traffic
        self._commit = commit
        self._news = threading.Condition()
        self._frames: deque[Frame | errors.PliantError] = deque()
        self._failure: errors.PliantError | None = None
        self._closed = False
        self._finished = False
        self._outgoing: _Outgoing = SimpleQueue()
        self._call: grpc.Call | None = None
        #: How often a lost connection was opened again.
        self.reconnects = 0
        #: Whether the connection is lost at the moment and looked for; poses wait, the newest goes out when it is back.
        self.lost = False
        self._reader = threading.Thread(target=self._run, name="pliant-stream", daemon=True)
        self._reader.start()

    def send(self, poses: Poses) -> int:
        """Sends a pose; handles that are not named stay where they are. Answers its number, which its frame carries."""
        with self._news:
            self._check()
            self._outgoing.put(self._traffic.pose(poses))
            return self._traffic.seq

    def receive(self, timeout: float | None = None) -> Frame:
        """Waits for the next frame and takes it.

        Raises what the server said when it rejected a pose (the stream continues), DeadlineExceeded after `timeout`
        seconds.
        """
        with self._news:
            if not self._news.wait_for(lambda: self._frames or self._failure or self._closed, timeout):
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

    def wait(self, timeout: float | None = None) -> Frame:
        """Waits for the final frame of the newest pose, and takes it with all before it."""
        end = None if timeout is None else time.monotonic() + timeout
        if self._traffic.seq == 0:
            raise errors.FailedPrecondition("no pose was sent on this stream")
        while True:
            frame = self.receive(None if end is None else max(0.0, end - time.monotonic()))
            if frame.final and frame.seq == self._traffic.seq:
                return frame

    def commit(self, poses: Poses | None = None) -> SolvedFrame:
        """Records where this stream's handles are, with `poses` on top, exactly once. Solved to the tolerance."""
        with self._news:
            self._check()
            everything = self._traffic.absorb(poses)
        return self._commit(everything)

    def absorb(self, poses: Poses) -> None:
        """Takes a pose into account without sending it: the next pose or commit carries it."""
        with self._news:
            self._traffic.absorb(poses)

    def finish(self) -> None:
        """Says that no more poses come: iterating ends after the final frame of the newest one."""
        with self._news:
            self._finished = True
            self._news.notify_all()

    def __iter__(self) -> Iterator[Frame]:
        """Frames as they come, until :meth:`finish` was called and the newest pose is answered."""
        while True:
            with self._news:
                self._news.wait_for(lambda: self._frames or self._failure or self._closed or self._done)
                if not self._frames:
                    if self._done:
                        return
                    self._check()
                item = self._take(self._frames.popleft())
            yield item

    @property
    def _done(self) -> bool:
        return self._finished and self._traffic.answered >= self._traffic.seq

    def close(self) -> None:
        """Ends the stream; a solve under way stops. The session stays."""
        with self._news:
            self._closed = True
            self._outgoing.put(None)
            if self._call is not None:
                self._call.cancel()
            self._news.notify_all()
        if threading.current_thread() is not self._reader:
            self._reader.join()

    def __enter__(self) -> Stream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _check(self) -> None:
        if self._closed:
            raise errors.FailedPrecondition("the stream is closed")
        if self._failure is not None:
            raise self._failure

    def _take(self, item: Frame | errors.PliantError) -> Frame:
        if isinstance(item, errors.PliantError):
            raise item
        # Frames up to this one may leave the server's window.
        self._outgoing.put(pb.DeformRequest(ack=pb.Ack(seq=item.seq)))
        return item

    def _run(self) -> None:
        try:
            self._read()
        except Exception as fault:
            # A defect of this package: who waits for a frame is told, and does not wait for ever.
            self._outgoing.put(None)
            with self._news:
                if self._call is not None:
                    self._call.cancel()
                self._failure = errors.Internal(f"{type(fault).__name__}: {fault}")
                self._news.notify_all()

    def _read(self) -> None:
        """Reads one connection after the other until the stream is closed or cannot continue."""
        attempts = channel.Attempts(self._calls.settings.patience)
        while True:
            outgoing: _Outgoing = SimpleQueue()
            error: errors.PliantError = errors.Unavailable("the server ended the stream")
            call = None
            try:
                with self._news:
                    if self._closed:
                        return
                    self._outgoing = outgoing
                    for message in self._traffic.opening():
                        outgoing.put(message)
                    self._call = call = self._calls.deform(iter(outgoing.get, None))
                for response in call:
                    attempts = channel.Attempts(self._calls.settings.patience, resuming=True)
                    self.lost = False
                    self._put(response)
            except grpc.RpcError as failed:
                error = self._calls.fault(failed)
            except errors.PliantError as broken:
                if call is not None:
                    call.cancel()
                error = broken
            outgoing.put(None)
            with self._news:
                pause = None if self._closed else attempts.again(error)
                self._call = None
                self.lost = True
            if pause is None or not self._calls.found(pause, attempts.left, lambda: self._closed):
                with self._news:
                    self._failure = self._calls.reason(attempts.last_word(error))
                    self._news.notify_all()
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
