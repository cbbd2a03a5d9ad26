"""Progress: reported to a callable, or shown as a bar of tqdm."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Any, TypeAlias, Union


#: Called with what is done and what there is to do in all; the latter is 0 where it is not known. One that has a method
#: ``stage`` gets the name of the current stage, such as "upload", and "build" while the server builds the solver.
Progress: TypeAlias = Callable[[int, int], None]
ProgressLike: TypeAlias = Union[bool, Progress]


class Meter(AbstractContextManager["Meter"]):
    """Reports what is done to a callable or a bar, when it is called."""

    def __init__(self, wish: ProgressLike, what: str, *, bytes: bool = False, unit: str = "pose") -> None:
        self._tell: Progress | None = wish if callable(wish) else None
        self._bar: Any = None
        self._stage = ""
        if wish is True:
            kind = {"unit": "B", "unit_scale": True, "unit_divisor": 1024} if bytes else {"unit": unit}
            try:
                from tqdm.auto import tqdm
            except ImportError:
                self._bar = _Line(what)
            else:
                self._bar = tqdm(desc=what, leave=False, **kind)
        self.stage(what)

    def stage(self, what: str) -> None:
        """Reports the current stage."""
        tell = getattr(self._tell, "stage", None)
        if what != self._stage and callable(tell):
            tell(what)
        if what != self._stage and self._bar is not None:
            self._bar.set_description(what)
        self._stage = what

    def __call__(self, done: int, total: int) -> None:
        if self._tell is not None:
            self._tell(done, total)
        if self._bar is not None:
            if total:
                self._bar.total = total
            self._bar.update(done - self._bar.n)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.close()


class _Line:
    """What there is of tqdm's bar without tqdm: one line on stderr, rewritten; without a terminal, one for each stage."""

    def __init__(self, what: str) -> None:
        self.total, self.n = 0, 0
        self._what = ""
        self._shown = 0
        self.set_description(what)

    def set_description(self, what: str) -> None:
        if what == self._what:
            return
        self._what = what
        self._write()
        if not sys.stderr.isatty():
            print(what, file=sys.stderr, flush=True)

    def update(self, more: int) -> None:
        self.n += more
        self._write()

    def close(self) -> None:
        self._write("")

    def _write(self, text: str | None = None) -> None:
        if not sys.stderr.isatty():
            return
        if text is None:
            text = f"{self._what}: {100 * self.n // self.total} %" if self.total else self._what
        print("\r" + text.ljust(self._shown) + ("" if text else "\r"), end="", file=sys.stderr, flush=True)
        self._shown = len(text)


def uploading(meter: Meter) -> Progress:
    """Reports an upload, and then that the server builds, without how far it is."""

    def tell(done: int, total: int) -> None:
        meter.stage("upload")
        meter(done, total)
        if done >= total:
            meter.stage("build")

    return tell
