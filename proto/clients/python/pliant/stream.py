"""A stream of poses and frames: the newest pose wins, and a lost connection is opened again."""

from __future__ import annotations

from . import aio
from .blocking import Face, blocking, iterating, plain


class Stream(Face):
    __doc__ = aio.Stream.__doc__

    _core: aio.Stream

    def __init__(self, core: aio.Stream) -> None:
        self._core = core

    send = plain(aio.Stream.send)
    receive = blocking(aio.Stream.receive)
    latest = plain(aio.Stream.latest)
    wait = blocking(aio.Stream.wait)
    commit = blocking(aio.Stream.commit)
    absorb = plain(aio.Stream.absorb)
    finish = plain(aio.Stream.finish)
    __iter__ = iterating(aio.Stream.__aiter__)

    @property
    def reconnects(self) -> int:
        """How often a lost connection was opened again."""
        return self._core.reconnects

    @property
    def lost(self) -> bool:
        """Whether the connection is lost at the moment and looked for; poses wait, the newest goes out when it is back."""
        return self._core.lost
