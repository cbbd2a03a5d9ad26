"""An animation as an iterator of its frames."""

from __future__ import annotations

from collections.abc import Iterator

from . import aio
from .animation import AnimatedFrame
from .blocking import Face
from .transport import run
from .v1 import pliant_pb2 as pb


class Animation(Face, Iterator[AnimatedFrame]):
    __doc__ = aio.Animation.__doc__

    _core: aio.Animation

    def __init__(self, core: aio.Animation) -> None:
        self._core = core

    @property
    def report(self) -> pb.AnimationReport | None:
        """Totals, warnings and what the handles of the rig hold; None until all frames have come."""
        return self._core.report

    @property
    def stage(self) -> tuple[str, float]:
        """What is under way before the first frame, and how much of it is done."""
        return self._core.stage

    @property
    def reconnects(self) -> int:
        """How often a lost connection was opened again."""
        return self._core.reconnects

    def __next__(self) -> AnimatedFrame:
        try:
            frame: AnimatedFrame = run(self._core.__anext__())
        except StopAsyncIteration:
            raise StopIteration from None
        return frame

    def __del__(self) -> None:
        # Who leaves a loop early does not want the rest.
        if not self._core.closed:
            self.close()
