"""The calls of the service, repeated where that is safe and worth it, failures as exceptions."""

from __future__ import annotations

import threading
import time
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

import grpc

from .. import channel, errors
from ..model import Upload
from ..poses import commit_in_parts
from ..progress import Progress
from ..route import AWAY_SECONDS, Route
from ..server import LocalServer
from ..transport import OnLoop
from ..v1 import pliant_pb2 as pb
from ..v1.pliant_pb2_grpc import DeformerStub

_T = TypeVar("_T")

#: Bytes of a pose that goes in parts: some less than a message may have by default.
_LARGE = 3 << 20


class Lines:
    """The connections of one client: one to its server, and one to each node that it was sent to."""

    def __init__(self, transport: OnLoop) -> None:
        self._transport = transport
        self._lock = threading.Lock()
        self._open: dict[str, tuple[Any, Any]] = {}
        self.closed = False

    def to(self, settings: channel.Settings) -> tuple[Any, Any]:
        """The channel to an address, and what calls on it."""
        with self._lock:
            if self.closed:
                raise errors.FailedPrecondition(channel.CLOSED)
            if settings.url not in self._open:
                made = self._transport.channel(settings)
                make_stub: Any = DeformerStub  # the generated file has no types
                self._open[settings.url] = (made, make_stub(made))
            return self._open[settings.url]

    async def close(self) -> None:
        """Closes them; calls under way are cancelled."""
        with self._lock:
            self.closed = True
        for line, _ in list(self._open.values()):
            await self._transport.close(line)


class Calls:
    """Calls to one server, about all or about one session."""

    def __init__(self, settings: channel.Settings, server: LocalServer | None, transport: OnLoop) -> None:
        self.settings = settings
        self.transport = transport
        self._server = server
        self._lines = Lines(transport)
        self._route = Route(settings)
        self._session = ""
        self._lines.to(settings)

    def toward(self, session: str) -> Calls:
        """Calls about one session, which go where it is; they begin where the last call was answered."""
        other = Calls.__new__(Calls)
        other.settings, other.transport = self.settings, self.transport
        other._server, other._lines = self._server, self._lines
        other._route, other._session = self._route.copy(), session
        self._route.go_home()
        return other

    async def close(self) -> None:
        """Closes the connections; calls under way are cancelled."""
        await self._lines.close()

    def check_open(self) -> None:
        """Raises when this connection was closed."""
        if self._lines.closed:
            raise errors.FailedPrecondition(channel.CLOSED)

    def _stub(self) -> Any:
        return self._lines.to(self._route.settings())[1]

    def _metadata(self, key: str | None, request: Any = None) -> tuple[tuple[str, str], ...]:
        session = self._session or str(getattr(request, "session_id", ""))
        return self.settings.metadata(key) + self._route.headers(session)

    async def one(self, name: str, request: Any, *, keyed: bool = False, patience: float | None = None) -> Any:
        """A call with one request and one answer. `keyed` calls happen once however often they are sent."""
        key = channel.key() if keyed else None

        async def attempt() -> Any:
            metadata = self._metadata(key, request)
            call = getattr(self._stub(), name)
            return await self.transport.one(call, request, metadata=metadata, timeout=self.settings.timeout)

        return await self._repeat(self._in_time(attempt, name), patience)

    async def many(self, name: str, request: Any, *, keyed: bool = False) -> list[Any]:
        """A call whose answer comes in pieces."""
        key = channel.key() if keyed else None

        async def attempt() -> list[Any]:
            metadata = self._metadata(key, request)
            call = getattr(self._stub(), name)(request, metadata=metadata, timeout=self.settings.timeout)
            return [piece async for piece in self.transport.answers(call)]

        return await self._repeat(self._in_time(attempt, name))

    async def create(self, upload: Upload, options: pb.CreateOptions, progress: Progress) -> pb.Session:
        """Uploads a model. The same upload is sent again where the connection was lost."""
        key = channel.key()
        limits: pb.Limits = await self.one("GetLimits", pb.GetLimitsRequest())

        async def attempt() -> pb.Session:
            requests = upload.requests(options, limits.message_bytes, progress)
            way = {"metadata": self._metadata(key), "timeout": self.settings.timeout}
            session = await self.transport.one(self._stub().CreateSession, requests, **way)
            assert isinstance(session, pb.Session)
            return session

        return await self._repeat(self._in_time(attempt, "CreateSession"))

    def _in_time(self, attempt: Callable[[], Awaitable[_T]], name: str) -> Callable[[], Awaitable[_T]]:
        """The same try of a call; where its time is over, that is said, in whatever words gRPC ends it."""
        timeout = self.settings.timeout

        async def timed() -> _T:
            begun = time.monotonic()
            try:
                return await attempt()
            except grpc.RpcError:
                if time.monotonic() - begun < timeout:
                    raise
                raise errors.DeadlineExceeded(
                    f"{name} took longer than the {timeout:g} s that the client waits for a call, and was given up, "
                    "and the server stops such work. timeout= of pliant.connect and pliant.open says how long"
                ) from None

        return timed

    async def commit(self, request: pb.SolveRequest) -> list[pb.Frame]:
        """A pose to solve and record, and the parts of its frame: by a call, or where that is too large for one message by a stream."""
        if request.ByteSize() <= _LARGE:
            return await self.many("Solve", request, keyed=True)
        messages = commit_in_parts(request, channel.key())

        async def attempt() -> list[pb.Frame]:
            queue, parts = self.transport.queue(), list[pb.Frame]()
            for message in messages:
                queue.put_nowait(message)
            call = self.deform(queue)
            try:
                async for response in self.transport.answers(call):
                    kind = response.WhichOneof("message")
                    if kind == "error":
                        raise errors.of_stream(response.error.code, response.error.message, response.error.seq)
                    if kind == "notice" and response.notice.code == "going-away":
                        break
                    if kind == "frame":
                        parts.append(response.frame)
                        if len(parts) == response.frame.parts:
                            return parts
            finally:
                call.cancel()
                queue.put_nowait(None)
            raise errors.Unavailable("the server ended the stream")

        return await self._repeat(attempt)

    def deform(self, requests: Any) -> Any:
        """Opens a stream that sends what comes into the queue `requests`; nothing is repeated here."""
        self.check_open()
        return self._stub().Deform(self.transport.messages(requests), metadata=self._metadata(None))

    def animate(self, requests: Any) -> Any:
        """Begins an animation, likewise."""
        self.check_open()
        return self._stub().Animate(self.transport.messages(requests), metadata=self._metadata(None))

    async def get(self, path: str) -> bytes:
        """The body of an HTTP GET, for what has no call in gRPC."""

        async def attempt() -> bytes:
            try:
                headers = self._route.headers(self._session)
                return await self.transport.aside(self._route.settings().get, path, headers)
            except errors.PliantError as error:
                self._route.learn(error)
                raise channel.of_session(error) from None

        return await self._repeat(attempt)

    def fault(self, error: grpc.RpcError) -> errors.PliantError:
        """What a failed call means here."""
        failed = errors.of_rpc(error)
        self._route.learn(failed)
        return self.reason(channel.of_session(failed))

    def reason(self, error: errors.PliantError) -> errors.PliantError:
        """The end of a server of one's own, where that lies behind a failure; it may show only after it."""
        return (self._server.ended if self._server is not None else None) or error

    async def found(self, pause: float, patience: float, given_up: Callable[[], bool] = lambda: False) -> bool:
        """Waits for `pause` seconds and then until there is a connection; whether there is one."""
        await self.transport.sleep(pause)
        if self._lines.closed:
            return False
        is_sure = self._route.is_sure
        patience = patience if is_sure else min(patience, AWAY_SECONDS)
        line = self._lines.to(self._route.settings())[0]
        end = time.monotonic() + patience

        def hopeless() -> bool:
            return (self._server is not None and self._server.ended is not None) or given_up()

        if await self.transport.ready(line, end, hopeless):
            return True
        # There is somebody else to ask.
        self._route.go_on()
        return not (is_sure or hopeless())

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
