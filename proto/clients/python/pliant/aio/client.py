"""The way in, for asyncio: opens sessions, finds open ones, asks for limits."""

from __future__ import annotations

import os
from collections.abc import AsyncIterator, Generator, Mapping
from types import TracebackType
from typing import Any
from urllib.parse import quote

from typing_extensions import Unpack

from .. import server as local
from ..channel import Settings
from ..model import Model, read
from ..options import CreateFields, create_options
from ..progress import Meter, ProgressLike, uploading
from ..server import LocalServer
from ..transport import OnLoop
from ..values import text
from ..v1 import pliant_pb2 as pb
from .calls import Calls
from .session import Session


def found(server: str | LocalServer | None) -> str | LocalServer:
    """The server given, that of PLIANT_SERVER, or one of our own, which may take a moment to start."""
    return server or os.environ.get("PLIANT_SERVER") or local.shared()


def settings(server: str | LocalServer | None, **way: Any) -> tuple[Settings, LocalServer | None]:
    """How to go there. A token may come from PLIANT_TOKEN."""
    way.setdefault("token", os.environ.get("PLIANT_TOKEN"))
    server = found(server)
    if isinstance(server, LocalServer):
        return Settings(server.url, **way), server
    return Settings(server, **way), None


class Client:
    """A connection to one server, for one event loop. Made by :func:`connect`."""

    _transport = OnLoop()

    def __init__(self, server: str | LocalServer | None = None, **way: Any) -> None:
        self._settings, owned = settings(server, **way)
        self._calls = Calls(self._settings, owned, self._transport)

    def __repr__(self) -> str:
        return f"<pliant.aio.Client of {self.url}>"

    @property
    def url(self) -> str:
        """The server's address."""
        return self._settings.url

    async def open(
        self,
        model: Model,
        *,
        companions: Mapping[str, bytes] | None = None,
        keep: bool = False,
        progress: ProgressLike = False,
        **create: Unpack[CreateFields],
    ) -> Session:
        """Uploads a model and opens a session with it; see :func:`pliant.open`."""
        return await self._open(model, companions, keep, progress, create, self_closing=False)

    async def _open(
        self,
        model: Model,
        companions: Mapping[str, bytes] | None,
        keep: bool,
        progress: ProgressLike,
        create: CreateFields,
        *,
        self_closing: bool,
    ) -> Session:
        options = create_options(create)
        with Meter(progress, "read", bytes=True) as tell:
            upload = await self._transport.aside(read, model, companions)
            options.format = options.format or upload.format
            options.label = options.label or upload.label
            info = await self._calls.create(upload, options, uploading(tell))
        return Session(self._calls.toward(info.id), info, keep=keep, at_close=self.close if self_closing else None)

    async def attach(self, session_id: str, *, keep: bool = True) -> Session:
        """Takes up an open session."""
        text("session_id", session_id)
        info = await self._calls.one("GetSession", pb.SessionRequest(session_id=session_id))
        return Session(self._calls.toward(info.id), info, keep=keep, at_close=None)

    async def sessions(self) -> AsyncIterator[pb.Session]:
        """The caller's open sessions, oldest first."""
        token = ""
        while True:
            page = await self._calls.one("ListSessions", pb.ListSessionsRequest(page_token=token))
            for session in page.sessions:
                yield session
            token = page.next_page_token
            if not token:
                return

    async def limits(self) -> pb.Limits:
        """The limits that the server enforces."""
        answer = await self._calls.one("GetLimits", pb.GetLimitsRequest())
        assert isinstance(answer, pb.Limits)
        return answer

    async def sample(self, name: str = "creature") -> bytes:
        """A built-in model, a GLB: the creature, or the figure, which has a skeleton, clips, levels of detail, a hull and
        sockets."""
        return await self._calls.get(f"/v1/sample.glb?name={quote(name, safe='')}")

    async def close(self) -> None:
        """Closes the connection. Sessions stay until they are closed or expire."""
        await self._calls.close()

    async def __aenter__(self) -> Client:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()


async def connect(server: str | LocalServer | None = None, **way: Any) -> Client:
    """Connects to a server; see :func:`pliant.connect`."""
    return Client(await Client._transport.aside(found, server), **way)


class Opening:
    """A model being opened: ``await`` it, or use it in ``async with``."""

    def __init__(self, arguments: dict[str, Any]) -> None:
        self._arguments = arguments
        self._session: Session | None = None

    async def _open(self) -> Session:
        given = dict(self._arguments)
        client = await connect(given.pop("server"), **given.pop("way"))
        try:
            return await client._open(**given, self_closing=True)
        except BaseException:
            await client.close()
            raise

    def __await__(self) -> Generator[Any, None, Session]:
        return self._open().__await__()

    async def __aenter__(self) -> Session:
        self._session = await self._open()
        return self._session

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._session is not None:
            await self._session.close()


def open(
    model: Model,
    *,
    server: str | LocalServer | None = None,
    way: Mapping[str, Any] | None = None,
    companions: Mapping[str, bytes] | None = None,
    keep: bool = False,
    progress: ProgressLike = False,
    **create: Unpack[CreateFields],
) -> Opening:
    """Opens a model; see :func:`pliant.open`. Use it as ``async with pliant.aio.open(...) as session``."""
    return Opening(
        {
            "server": server,
            "way": dict(way or {}),
            "model": model,
            "companions": companions,
            "keep": keep,
            "progress": progress,
            "create": create,
        }
    )
