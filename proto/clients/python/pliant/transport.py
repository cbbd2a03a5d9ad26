"""How the client talks and waits: on asyncio's event loop, or by blocking the calling thread.

:mod:`pliant.aio` waits only through one of these two. A coroutine over :class:`Blocking` never suspends, so that :func:`run` carries it
to its end as a plain call.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import nullcontext
from queue import SimpleQueue
from typing import Any, TypeVar

import grpc
import grpc.aio

from .channel import Settings

_T = TypeVar("_T")

#: Seconds between looks at whether waiting for a connection still makes sense.
_GLANCE = 0.5


def _until(end: float) -> float:
    """Seconds to the next of these looks, or to `end` where that is nearer."""
    return min(_GLANCE, max(0.0, end - time.monotonic()))


class OnLoop:
    """Waits on the running event loop of asyncio."""

    #: The module that makes channels of this kind.
    channels: Any = grpc.aio

    def channel(self, settings: Settings) -> Any:
        """A channel to an address."""
        if settings.secure:
            return self.channels.secure_channel(settings.target, settings.credentials(), options=settings.options())
        return self.channels.insecure_channel(settings.target, options=settings.options())

    async def close(self, line: Any) -> None:
        """Closes a channel; calls under way are cancelled."""
        await line.close()

    async def ready(self, line: Any, end: float, hopeless: Callable[[], bool]) -> bool:
        """Waits until a channel is connected; False at the time `end` of the monotonic clock, or before that when it is `hopeless()`."""
        while True:
            try:
                await asyncio.wait_for(line.channel_ready(), _until(end))
            except asyncio.TimeoutError:
                if time.monotonic() >= end or hopeless():
                    return False
            else:
                return True

    async def one(self, method: Any, request: Any, **way: Any) -> Any:
        """The answer of a call that has one."""
        return await method(request, **way)

    def answers(self, call: Any) -> AsyncIterator[Any]:
        """The answers of a call that has many, as they come."""
        return call  # type: ignore[no-any-return]

    async def aside(self, work: Callable[..., _T], *arguments: Any) -> _T:
        """What blocks a thread for a moment, such as reading a file."""
        return await asyncio.to_thread(work, *arguments)

    async def sleep(self, seconds: float) -> None:
        """Waits."""
        await asyncio.sleep(seconds)

    def queue(self) -> Any:
        """A queue of messages to the server, to which ``put_nowait`` adds; None ends it."""
        return asyncio.Queue()

    async def messages(self, queue: Any) -> Any:
        """What comes into a queue, as gRPC takes it."""
        while (message := await queue.get()) is not None:
            yield message

    def news(self) -> Any:
        """A lock, for a ``with`` block, in which :meth:`wait_for` waits until ``notify_all`` says that something changed."""
        return _News()

    async def wait_for(self, news: Any, holds: Callable[[], object], timeout: float | None) -> bool:
        """Waits until `holds()`; False when that takes longer than `timeout` seconds."""

        async def wait() -> None:
            while not holds():
                news.changed.clear()
                await news.changed.wait()

        # With no time left asyncio would not even look.
        if holds():
            return True
        try:
            await asyncio.wait_for(wait(), timeout)
        except asyncio.TimeoutError:
            return False
        return True

    def task(self, work: Coroutine[Any, Any, None], name: str) -> Any:
        """Starts work beside the caller's; ``cancel`` ends it where it waits."""
        return asyncio.create_task(work, name=name)

    async def ended(self, task: Any) -> BaseException | None:
        """Waits for the end of a task, and answers what it raised."""
        ended: list[BaseException | None] = await asyncio.gather(task, return_exceptions=True)
        return ended[0]


class _News(nullcontext[None]):
    """Tasks of one loop never run at the same time: there is nothing to lock."""

    def __init__(self) -> None:
        super().__init__()
        self.changed = asyncio.Event()

    def notify_all(self) -> None:
        self.changed.set()


class Blocking(OnLoop):
    """Blocks the calling thread. Threads may share what is built on it."""

    channels = grpc

    async def close(self, line: Any) -> None:
        line.close()

    async def ready(self, line: Any, end: float, hopeless: Callable[[], bool]) -> bool:
        # gRPC connects only while somebody waits for it, and calls that fail at once do not wait. One future for all of the time:
        # a second one on a channel that is closed meanwhile lets gRPC's own thread fail, with a trace on stderr.
        ready = grpc.channel_ready_future(line)
        while True:
            try:
                ready.result(timeout=_until(end))
            except grpc.FutureTimeoutError:
                if time.monotonic() >= end or hopeless():
                    ready.cancel()
                    return False
            else:
                return True

    async def one(self, method: Any, request: Any, **way: Any) -> Any:
        return method(request, **way)

    async def answers(self, call: Any) -> AsyncIterator[Any]:
        for answer in call:
            yield answer

    async def aside(self, work: Callable[..., _T], *arguments: Any) -> _T:
        return work(*arguments)

    async def sleep(self, seconds: float) -> None:
        time.sleep(seconds)

    def queue(self) -> Any:
        return SimpleQueue()

    def messages(self, queue: Any) -> Any:
        return iter(queue.get, None)

    def news(self) -> Any:
        return threading.Condition()

    async def wait_for(self, news: Any, holds: Callable[[], object], timeout: float | None) -> bool:
        return bool(news.wait_for(holds, timeout))

    def task(self, work: Coroutine[Any, Any, None], name: str) -> Any:
        return _Thread(work, name)

    async def ended(self, task: Any) -> BaseException | None:
        if threading.current_thread() is not task:
            task.join()
        raised: BaseException | None = task.raised
        return raised


class _Thread(threading.Thread):
    def __init__(self, work: Coroutine[Any, Any, None], name: str) -> None:
        super().__init__(name=name, daemon=True)
        self._work = work
        self.raised: BaseException | None = None
        self.start()

    def run(self) -> None:
        try:
            run(self._work)
        except BaseException as error:
            self.raised = error

    def cancel(self) -> None:
        """Does nothing: a thread ends when the call that it waits for is cancelled."""


def run(work: Any) -> Any:
    """Carries a coroutine over :class:`Blocking` to its end, in this thread, and answers what it answers."""
    try:
        next(work.__await__())
    except StopIteration as done:
        return done.value
    raise RuntimeError("a blocking call waited for an event loop")
