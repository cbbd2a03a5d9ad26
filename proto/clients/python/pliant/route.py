"""Where the calls about one session go: to the server that was named, or to the node that has the session.

Several servers may share a store. Each session is at one of them, and every other one says where.
"""

from __future__ import annotations

from dataclasses import replace

from . import errors
from .channel import Settings, is_lost

#: Seconds for which a node that another one named is waited for, before the way is asked for again.
AWAY_SECONDS = 1.0


class Route:
    """The way to one session, as far as it is known."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._homes = (settings.url, *settings.others)
        self._turn = 0
        # Address and name together, so that a thread never sees one of two.
        self._place: tuple[str, str | None] = (settings.url, None)

    def copy(self) -> Route:
        """Another session's way, which begins like this one."""
        other = Route(self._settings)
        other._turn, other._place = self._turn, self._place
        return other

    @property
    def url(self) -> str:
        """The address to call."""
        return self._place[0]

    @property
    def is_sure(self) -> bool:
        """Whether there is no other address to ask, however long this one is away."""
        return len(self._homes) == 1 and self.url == self._homes[0]

    def settings(self) -> Settings:
        """How to reach that address."""
        return replace(self._settings, url=self.url, others=())

    def headers(self, session: str) -> tuple[tuple[str, str], ...]:
        """What proxies before several nodes choose by: the session, and the node that has it, where that is known."""
        node = self._place[1]
        named = (("x-pliant-node", node),) if node is not None else ()
        return ((("x-pliant-session", session),) if session else ()) + named

    def learn(self, error: errors.PliantError) -> None:
        """Takes from a failure where to go next."""
        if error.owner is not None:
            there = Settings(error.owner)
            # A token that was to be encrypted is shown to nobody in the open.
            if there.secure or not self._settings.secure:
                self._place = (there.url, error.node)
        elif is_lost(error):
            self.go_on()

    def go_on(self) -> None:
        """The server does not answer: goes back to a named server, and from there to the next of them."""
        if self.url == self._homes[self._turn]:
            self._turn = (self._turn + 1) % len(self._homes)
        self.go_home()

    def go_home(self) -> None:
        """Back to a named server."""
        self._place = (self._homes[self._turn], None)
