"""The way in: opens sessions, finds open ones, asks for limits."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from types import TracebackType
from typing import Any
from urllib.parse import quote

from typing_extensions import Unpack

from . import server as local
from .calls import Calls
from .channel import Settings
from .model import Model, read
from .options import CreateFields, create_options
from .progress import Meter, ProgressLike, uploading
from .session import Session
from .values import text
from .v1 import pliant_pb2 as pb


def found(server: str | local.LocalServer | None) -> str | local.LocalServer:
    """The server given, that of PLIANT_SERVER, or one of our own, which may take a moment to start."""
    return server or os.environ.get("PLIANT_SERVER") or local.shared()


def settings(server: str | local.LocalServer | None, **way: Any) -> tuple[Settings, local.LocalServer | None]:
    """How to go there. A token may come from PLIANT_TOKEN."""
    way.setdefault("token", os.environ.get("PLIANT_TOKEN"))
    server = found(server)
    if isinstance(server, local.LocalServer):
        return Settings(server.url, **way), server
    return Settings(server, **way), None


class Client:
    """A connection to one server. Made by :func:`connect`."""

    def __init__(self, server: str | local.LocalServer | None = None, **way: Any) -> None:
        self._settings, owned = settings(server, **way)
        self._calls = Calls(self._settings, owned)

    @property
    def url(self) -> str:
        """The server's address."""
        return self._settings.url

    def open(
        self,
        model: Model,
        *,
        companions: Mapping[str, bytes] | None = None,
        keep: bool = False,
        progress: ProgressLike = False,
        **create: Unpack[CreateFields],
    ) -> Session:
        """Uploads a model and opens a session with it; see :func:`pliant.open`."""
        return self._open(model, companions, keep, progress, create, self_closing=False)

    def _open(
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
            upload = read(model, companions)
            options.format = options.format or upload.format
            options.label = options.label or upload.label
            info = self._calls.create(upload, options, uploading(tell))
        return Session(self._calls.toward(info.id), info, keep=keep, at_close=self.close if self_closing else None)

    def attach(self, session_id: str, *, keep: bool = True) -> Session:
        """Takes up an open session."""
        text("session_id", session_id)
        info = self._calls.one("GetSession", pb.SessionRequest(session_id=session_id))
        return Session(self._calls.toward(info.id), info, keep=keep, at_close=None)

    def sessions(self) -> Iterator[pb.Session]:
        """The caller's open sessions, oldest first."""
        token = ""
        while True:
            page = self._calls.one("ListSessions", pb.ListSessionsRequest(page_token=token))
            yield from page.sessions
            token = page.next_page_token
            if not token:
                return

    def limits(self) -> pb.Limits:
        """The limits that the server enforces."""
        answer = self._calls.one("GetLimits", pb.GetLimitsRequest())
        assert isinstance(answer, pb.Limits)
        return answer

    def sample(self, name: str = "creature") -> bytes:
        """A built-in model, a GLB: the creature, or the figure, which has a skeleton, clips, levels of detail, a hull and
        sockets."""
        return self._calls.get(f"/v1/sample.glb?name={quote(name, safe='')}")

    def close(self) -> None:
        """Closes the connection. Sessions stay until they are closed or expire."""
        self._calls.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def connect(server: str | local.LocalServer | None = None, **way: Any) -> Client:
    """Connects to a server: ``http://HOST:PORT`` (plain) or ``https://HOST:PORT`` (TLS).

    Without one the server of the environment variable PLIANT_SERVER is taken, else one of our own is started on a free
    port of this machine and stopped when Python ends. `way` are the fields of :class:`pliant.Settings`: ``token``,
    ``ca``, ``timeout``, ``patience``, ``message_bytes``, ``window_bytes``, ``others``. Where several servers share a store,
    each session's calls go to the node that has it; ``others`` are further addresses to ask when the first one is away.
    """
    return Client(server, **way)


def open(
    model: Model,
    *,
    server: str | local.LocalServer | None = None,
    way: Mapping[str, Any] | None = None,
    companions: Mapping[str, bytes] | None = None,
    keep: bool = False,
    progress: ProgressLike = False,
    **create: Unpack[CreateFields],
) -> Session:
    """Opens a model: a path, the bytes of a file, an open file, ``(vertices, faces)``, or a mesh with these attributes.

    `companions` are files that the model refers to, by URI; those of a .gltf, buffers and images, are found beside it. The session is
    deleted when it is closed, unless `keep` is given. Its label is the file's name, unless `label` says another. `progress` is True for
    a bar, or a callable that gets bytes; both get the stages ``read``, ``upload`` and ``build``, a callable by its method
    ``stage`` if it has one. `create` says how the session is built: ``volume_graph``,
    ``components``, ``parts``, ``tie_distance``, ``keep_apart``, ``weights``, ``weld``, ``operators``,
    ``morph_targets``, ``rig``, ``bone_lengths``, ``rigid_chains``, ``passengers``, ``ttl``, ``label``, ``format``. `server` and
    `way` are as in :func:`connect`.
    """
    client = Client(server, **(way or {}))
    try:
        return client._open(model, companions, keep, progress, create, self_closing=True)
    except BaseException:
        client.close()
        raise
