"""The calls of the service, repeated where that is safe and worth it, failures as exceptions."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import grpc

from . import channel, errors
from .model import Upload
from .progress import Progress
from .server import LocalServer
from .v1 import pliant_pb2 as pb
from .v1.pliant_pb2_grpc import DeformerStub

_T = TypeVar("_T")

#: Seconds between looks at whether a server of one's own still runs.
_GLANCE = 0.5


class Calls:
    """One connection to one server. Threads may share it."""

    def __init__(self, settings: channel.Settings, server: LocalServer | None = None) -> None:
        self.settings = settings
        self._server = server
        self._closed = False
        options = settings.options()
        if settings.secure:
            self._channel = grpc.secure_channel(settings.target, settings.credentials(), options=options)
        else:
            self._channel = grpc.insecure_channel(settings.target, options=options)
        make_stub: Any = DeformerStub  # the generated file has no types
        self._stub = make_stub(self._channel)

    def close(self) -> None:
        """Closes the connection; calls under way are cancelled."""
        self._closed = True
        self._channel.close()

    def check_open(self) -> None:
        """Raises when this connection was closed."""
        if self._closed:
            raise errors.FailedPrecondition(channel.CLOSED)

    def one(self, name: str, request: Any, *, keyed: bool = False, patience: float | None = None) -> Any:
        """A call with one request and one answer. `keyed` calls happen once however often they are sent."""
        metadata = self.settings.metadata(channel.key() if keyed else None)
        call = getattr(self._stub, name)
        return self._repeat(lambda: call(request, metadata=metadata, timeout=self.settings.timeout), patience)

    def many(self, name: str, request: Any, *, keyed: bool = False) -> list[Any]:
        """A call whose answer comes in pieces."""
        metadata = self.settings.metadata(channel.key() if keyed else None)
        call = getattr(self._stub, name)
        return self._repeat(lambda: list(call(request, metadata=metadata, timeout=self.settings.timeout)))

    def create(self, upload: Upload, options: pb.CreateOptions, progress: Progress) -> pb.Session:
        """Uploads a model. The same upload is sent again where the connection was lost."""
        metadata = self.settings.metadata(channel.key())
        limits: pb.Limits = self.one("GetLimits", pb.GetLimitsRequest())

        def attempt() -> pb.Session:
            requests = upload.requests(options, limits.message_bytes, progress)
            session = self._stub.CreateSession(requests, metadata=metadata, timeout=self.settings.timeout)
            assert isinstance(session, pb.Session)
            return session

        return self._repeat(attempt)

    def deform(self, requests: Iterator[pb.DeformRequest]) -> Any:
        """Opens a stream; nothing is repeated here."""
        self.check_open()
        return self._stub.Deform(requests, metadata=self.settings.metadata())

    def animate(self, requests: Iterator[pb.AnimateRequest]) -> Any:
        """Begins an animation; nothing is repeated here."""
        self.check_open()
        return self._stub.Animate(requests, metadata=self.settings.metadata())

    def get(self, path: str) -> bytes:
        """The body of an HTTP GET, for what has no call in gRPC."""

        def attempt() -> bytes:
            try:
                return self.settings.get(path)
            except errors.PliantError as error:
                raise channel.of_session(error) from None

        return self._repeat(attempt)

    def fault(self, error: grpc.RpcError) -> errors.PliantError:
        """What a failed call means here."""
        return self.reason(channel.of_session(errors.of_rpc(error)))

    def reason(self, error: errors.PliantError) -> errors.PliantError:
        """The end of a server of one's own, where that lies behind a failure; it may show only after it."""
        return (self._server.ended if self._server is not None else None) or error

    def found(self, pause: float, patience: float, given_up: Callable[[], bool] = lambda: False) -> bool:
        """Waits for `pause` seconds and then until there is a connection; whether there is one."""
        time.sleep(pause)
        if self._closed:
            return False
        # gRPC connects only while somebody waits for it, and calls that fail at once do not wait.
        ready = grpc.channel_ready_future(self._channel)
        end = time.monotonic() + patience
        while True:
            try:
                ready.result(timeout=min(_GLANCE, max(0.0, end - time.monotonic())))
                return True
            except grpc.FutureTimeoutError:
                hopeless = self._server is not None and self._server.ended is not None
                if time.monotonic() >= end or hopeless or given_up():
                    ready.cancel()
                    return False

    def _repeat(self, attempt: Callable[[], _T], patience: float | None = None) -> _T:
        attempts = channel.Attempts(self.settings.patience if patience is None else patience)
        while True:
            self.check_open()
            try:
                return attempt()
            except grpc.RpcError as failed:
                error = self.fault(failed)
            except errors.PliantError as failed:
                error = self.reason(failed)
            pause = attempts.again(error)
            if pause is None or not self.found(pause, attempts.left):
                raise self.reason(attempts.last_word(error))
