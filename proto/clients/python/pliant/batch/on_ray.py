"""Ray as an executor."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any, TypeVar

_T = TypeVar("_T")


def _call(function: Callable[..., Any], args: tuple[Any, ...], named: dict[str, Any]) -> Any:
    return function(*args, **named)


class RayExecutor(Executor):
    """Runs calls as tasks of Ray, on the cluster that ``ray.init`` has named, or one of this machine that it starts.

    `options` are those of ``ray.remote``, such as ``num_cpus=4``. Ray's own retries are off: the batch has its own, which it counts.
    """

    def __init__(self, **options: Any) -> None:
        try:
            ray: Any = importlib.import_module("ray")
        except ImportError:
            raise ImportError("RayExecutor needs Ray: pip install ray") from None
        if not ray.is_initialized():
            ray.init()
        self._remote: Any = ray.remote(**{"max_retries": 0, "num_cpus": 1, **options})(_call)
        self._closed = False

    def submit(self, fn: Callable[..., _T], /, *args: Any, **kwargs: Any) -> Future[_T]:
        """Gives a call to Ray; its future reports when it is done."""
        if self._closed:
            raise RuntimeError("this executor was shut down")
        made: Future[_T] = self._remote.remote(fn, args, kwargs).future()
        return made

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Takes no more calls. Ray itself continues, as it may have other work."""
        self._closed = True
