"""The way in: opens sessions, finds open ones, asks for limits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from typing_extensions import Unpack

from . import aio
from .blocking import Face, blocking, iterating
from .model import Model
from .options import CreateFields
from .progress import ProgressLike
from .server import LocalServer
from .session import Session
from .transport import Blocking, run


class _Core(aio.Client):
    _transport = Blocking()


class Client(Face):
    """A connection to one server. Made by :func:`connect`."""

    _core: aio.Client

    def __init__(self, server: str | LocalServer | None = None, **way: Any) -> None:
        self._core = _Core(server, **way)

    def __repr__(self) -> str:
        return f"<pliant.Client of {self.url}>"

    @property
    def url(self) -> str:
        """The server's address."""
        return self._core.url

    open = blocking(aio.Client.open, Session)
    attach = blocking(aio.Client.attach, Session)
    sessions = iterating(aio.Client.sessions)
    limits = blocking(aio.Client.limits)
    sample = blocking(aio.Client.sample)
    close = blocking(aio.Client.close)


def connect(server: str | LocalServer | None = None, **way: Any) -> Client:
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
    server: str | LocalServer | None = None,
    way: Mapping[str, Any] | None = None,
    companions: Mapping[str, bytes] | None = None,
    keep: bool = False,
    progress: ProgressLike = False,
    **create: Unpack[CreateFields],
) -> Session:
    """Opens a model: a path, the bytes of a file, an open file, ``(vertices, faces)``, a mesh with these attributes, or a trimesh scene.

    `companions` are files that the model refers to, by URI; those of a .gltf, buffers and images, are found beside it. The session is
    deleted when it is closed, unless `keep` is given. Its label is the file's name, unless `label` says another. `progress` is True for
    a bar, or a callable that gets bytes; both get the stages ``read``, ``upload`` and ``build``, a callable by its method
    ``stage`` if it has one. `create` says how the session is built: ``volume_graph``,
    ``components``, ``parts``, ``tie_distance``, ``keep_apart``, ``weights``, ``weld``, ``operators``,
    ``morph_targets``, ``rig``, ``bone_lengths``, ``rigid_chains``, ``passengers``, ``large_splats``, ``cage_triangles``, ``ttl``,
    ``label``, ``format``. `server` and
    `way` are as in :func:`connect`.
    """
    client = Client(server, **(way or {}))
    try:
        return Session(run(client._core._open(model, companions, keep, progress, create, self_closing=True)))
    except BaseException:
        client.close()
        raise
