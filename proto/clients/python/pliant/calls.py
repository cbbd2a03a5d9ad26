"""The calls of the service as plain methods, for what a session has no method for."""

from __future__ import annotations

from .aio import calls as core
from .blocking import Face, blocking


class Calls(Face):
    """Calls to one server, about all or about one session. Threads may share it."""

    _core: core.Calls

    def __init__(self, calls: core.Calls) -> None:
        self._core = calls

    create = blocking(core.Calls.create)
    one = blocking(core.Calls.one)
    many = blocking(core.Calls.many)

    def toward(self, session: str) -> Calls:
        """Calls about one session."""
        return Calls(self._core.toward(session))
