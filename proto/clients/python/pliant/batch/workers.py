"""The executor of a batch: made, watched, and made again where its processes died."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeout
from typing import Any, Union

from ..errors import PliantError
from ..values import seen
from .jobs import Task
from .work import Outcome, Place, probe, work

#: An executor, what makes one, or nothing for a pool of processes.
ExecutorLike = Union[Executor, Callable[[], Executor], None]

#: So often workers are looked for before the batch is given up.
_STARTS = 3


class WorkersLost(PliantError):
    """There are no workers, or none that can work. Results that were made are kept."""

    code = "UNAVAILABLE"


class Workers:
    """Hands tasks to an executor."""

    def __init__(self, executor: ExecutorLike, count: int, place: Place, start_timeout: float) -> None:
        self._place = place
        self._start_timeout = start_timeout
        self._count = count
        self._given = executor if isinstance(executor, Executor) else None
        make: Callable[[], Executor] | None = None
        if executor is None:
            make = self._processes
        elif self._given is None:
            if not callable(executor):
                raise TypeError(
                    f"executor: {seen(executor)}, an Executor, a function that makes one, or None is allowed"
                )
            make = executor
        else:
            _refuse_forks(self._given)
        self._make = make
        self._now: Executor | None = None
        #: The version of the server of the worker that was asked first.
        self.version = ""
        #: Counts the executors: a report of one that is gone does not end its successor.
        self.generation = 0

    def _processes(self) -> Executor:
        # gRPC does not survive a fork.
        return ProcessPoolExecutor(self._count, mp_context=multiprocessing.get_context("spawn"))

    def submit(self, task: Task) -> Future[Outcome]:
        """Hands over a task; raises what the executor raises."""
        return self._ready().submit(work, task, self._place)

    def asked_version(self) -> str:
        """The version that a worker's server has."""
        self._ready()
        return self.version

    def _ready(self) -> Executor:
        """An executor that has shown that it can work."""
        if self._now is not None:
            return self._now
        words = "nothing"
        for _ in range(_STARTS):
            started = self._start()
            try:
                name, self.version, hindrance = started.submit(probe, self._place).result(timeout=self._start_timeout)
            except FutureTimeout:
                words = f"none answered within {self._start_timeout:g} s"
            except Exception as lost:
                words = f"{type(lost).__name__}: {lost}"
            else:
                if not hindrance:
                    return started
                words = f"{name} says: {hindrance}"
            self.discard()
            if self._make is None:
                break
        guard = '; a script that starts processes needs `if __name__ == "__main__":` around what it does'
        again = "; where workers may die, executor= takes a function that makes an executor"
        hint = again if self._make is None else guard
        raise WorkersLost(f"no worker can work: {words}{hint}")

    def _start(self) -> Executor:
        made = self._given if self._make is None else self._make()
        if not isinstance(made, Executor):
            raise TypeError(f"executor: the function made {seen(made)}, an Executor is allowed")
        _refuse_forks(made)
        self._now = made
        self.generation += 1
        return made

    def discard(self) -> None:
        """Lets go of an executor that is broken."""
        gone, self._now = self._now, None
        if gone is not None and self._make is not None:
            gone.shutdown(wait=False, cancel_futures=True)

    def close(self, *, at_once: bool) -> None:
        """Ends what was started here, and leaves an executor that the caller gave."""
        gone, self._now = self._now, None
        if gone is None or self._make is None:
            return
        # Names that are not public before Python 3.14: without them the workers finish their jobs first.
        processes = dict(getattr(gone, "_processes", None) or {}) if at_once else {}
        gone.shutdown(wait=not at_once, cancel_futures=True)
        for process in processes.values():
            process.terminate()


def _refuse_forks(executor: Executor) -> None:
    if isinstance(executor, ProcessPoolExecutor):
        context: Any = getattr(executor, "_mp_context", None)
        if context is not None and context.get_start_method() == "fork":
            raise ValueError(
                "executor: a process pool that forks, which gRPC does not survive; allowed is "
                'ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn"))'
            )


def default_count() -> int:
    """Workers of the pool that is the default: solves use several cores each."""
    return max(1, min(8, (os.cpu_count() or 2) // 2))
