"""The calls of the service on asyncio's event loop."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any, TypeVar

import grpc
import grpc.aio

from .. import channel, errors
from ..model import Upload
from ..progress import Progress
from ..server import LocalServer
from ..v1 import pliant_pb2 as pb
from ..v1.pliant_pb2_grpc import DeformerStub

_T = TypeVar("_T")

#: Seconds between looks at whether a server of one's own still runs.
_GLANCE = 0.5


class Calls:
    """One connection to one server, for one event loop."""

    def __init__(self, settings: channel.Settings, server: LocalServer | None = None) -> None:
        self.settings = settings
        self._server = server
        self._closed = False
        options = settings.options()
        if settings.secure:
            self._channel = grpc.aio.secure_channel(settings.target, settings.credentials(), options=options)
        else:
            self._channel = grpc.aio.insecure_channel(settings.target, options=options)
        make_stub: Any = DeformerStub  # the generated file has no types
        self._stub = make_stub(self._channel)

    async def close(self) -> None:
        """Closes the connection; calls under way are cancelled."""
        self._closed = True
        await self._channel.close()

    def check_open(self) -> None:
        """Raises when this connection was closed."""
        if self._closed:
            raise errors.FailedPrecondition(channel.CLOSED)

    async def one(self, name: str, request: Any, *, keyed: bool = False, patience: float | None = None) -> Any:
        """A call with one request and one answer. `keyed` calls happen once however often they are sent."""
        metadata = self.settings.metadata(channel.key() if keyed else None)

        async def attempt() -> Any:
            return await getattr(self._stub, name)(request, metadata=metadata, timeout=self.settings.timeout)

        return await self._repeat(attempt, patience)

    async def many(self, name: str, request: Any, *, keyed: bool = False) -> list[Any]:
        """A call whose answer comes in pieces."""
        metadata = self.settings.metadata(channel.key() if keyed else None)

        async def attempt() -> list[Any]:
            call = getattr(self._stub, name)(request, metadata=metadata, timeout=self.settings.timeout)
            return [piece async for piece in call]

        return await self._repeat(attempt)

    async def create(self, upload: Upload, options: pb.CreateOptions, progress: Progress) -> pb.Session:
        """Uploads a model. The same upload is sent again where the connection was lost."""
        metadata = self.settings.metadata(channel.key())
        limits: pb.Limits = await self.one("GetLimits", pb.GetLimitsRequest())

        async def attempt() -> pb.Session:
            requests = upload.requests(options, limits.message_bytes, progress)
            session = await self._stub.CreateSession(requests, metadata=metadata, timeout=self.settings.timeout)
            assert isinstance(session, pb.Session)
            return session

        return await self._repeat(attempt)

    def deform(self, requests: AsyncIterator[pb.DeformRequest]) -> Any:
        """Opens a stream; nothing is repeated here."""
        self.check_open()
        return self._stub.Deform(requests, metadata=self.settings.metadata())

    def animate(self, requests: AsyncIterator[pb.AnimateRequest]) -> Any:
        """Begins an animation; nothing is repeated here."""
        self.check_open()
        return self._stub.Animate(requests, metadata=self.settings.metadata())

    async def get(self, path: str) -> bytes:
        """The body of an HTTP GET, for what has no call in gRPC."""

        async def attempt() -> bytes:
            try:
                return await asyncio.to_thread(self.settings.get, path)
            except errors.PliantError as error:
                raise channel.of_session(error) from None

        return await self._repeat(attempt)

    def fault(self, error: grpc.RpcError) -> errors.PliantError:
        """What a failed call means here."""
        return self.reason(channel.of_session(errors.of_rpc(error)))

    def reason(self, error: errors.PliantError) -> errors.PliantError:
        """The end of a server of one's own, where that lies behind a failure; it may show only after it."""
        return (self._server.ended if self._server is not None else None) or error

    async def found(self, pause: float, patience: float) -> bool:
        """Waits for `pause` seconds and then until there is a connection; whether there is one."""
        await asyncio.sleep(pause)
        if self._closed:
            return False
        end = time.monotonic() + patience
        while True:
            try:
                await asyncio.wait_for(self._channel.channel_ready(), min(_GLANCE, max(0.0, end - time.monotonic())))
                return True
            except asyncio.TimeoutError:
                if time.monotonic() >= end or (self._server is not None and self._server.ended):
                    return False

    async def _repeat(self, attempt: Callable[[], Awaitable[_T]], patience: float | None = None) -> _T:
        attempts = channel.Attempts(self.settings.patience if patience is None else patience)
        while True:
            self.check_open()
            try:
                return await attempt()
            except grpc.RpcError as failed:
                error = self.fault(failed)
            except errors.PliantError as failed:
                error = self.reason(failed)
            pause = attempts.again(error)
            if pause is None or not await self.found(pause, attempts.left):
                raise self.reason(attempts.last_word(error))
