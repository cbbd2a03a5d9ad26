"""Plain methods, made of the coroutines of :mod:`pliant.aio`: the same calls, arguments, types and texts."""

from __future__ import annotations

import functools
import inspect
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from types import GenericAlias, TracebackType
from typing import Any, Concatenate, ParamSpec, TypeVar, overload

from typing_extensions import Self

from .transport import run

P = ParamSpec("P")
T = TypeVar("T")
F = TypeVar("F")


class Face:
    """A class of :mod:`pliant`: what it does, its `_core` of :mod:`pliant.aio` does, over a blocking transport."""

    _core: Any

    def close(self) -> None:
        """Ends what the ``with`` block began."""
        run(self._core.close())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


@overload
def blocking(call: Callable[Concatenate[Any, P], Awaitable[T]]) -> Callable[Concatenate[Any, P], T]: ...


@overload
def blocking(
    call: Callable[Concatenate[Any, P], Awaitable[T]], face: Callable[[T], F]
) -> Callable[Concatenate[Any, P], F]: ...


def blocking(call: Any, face: Any = None) -> Any:
    """A coroutine as a plain method; what it answers becomes a `face` where one is named."""

    @functools.wraps(call)
    def method(self: Face, /, *positional: Any, **named: Any) -> Any:
        answer = run(call(self._core, *positional, **named))
        return answer if face is None else face(answer)

    return method


@overload
def plain(call: Callable[Concatenate[Any, P], T]) -> Callable[Concatenate[Any, P], T]: ...


@overload
def plain(call: Callable[Concatenate[Any, P], T], face: Callable[[T], F]) -> Callable[Concatenate[Any, P], F]: ...


def plain(call: Any, face: Any = None) -> Any:
    """A plain method of the core, likewise."""

    @functools.wraps(call)
    def method(self: Face, /, *positional: Any, **named: Any) -> Any:
        answer = call(self._core, *positional, **named)
        return answer if face is None else face(answer)

    return method


def iterating(call: Callable[Concatenate[Any, P], AsyncIterator[T]]) -> Callable[Concatenate[Any, P], Iterator[T]]:
    """An asynchronous iterator as a plain one."""

    @functools.wraps(call)
    def method(self: Face, /, *positional: P.args, **named: P.kwargs) -> Iterator[T]:
        items = call(self._core, *positional, **named)
        try:
            while True:
                try:
                    item = run(items.__anext__())
                except StopAsyncIteration:
                    return
                yield item
        finally:
            run(items.aclose())  # type: ignore[attr-defined]

    # The first for people, the second for who evaluates it in the module of the core.
    hint = call.__annotations__["return"].removeprefix("Async")
    item: Any = hint.removeprefix("Iterator[").removesuffix("]")
    method.__signature__ = inspect.signature(call).replace(return_annotation=hint)  # type: ignore[attr-defined]
    method.__annotations__ = {**call.__annotations__, "return": GenericAlias(Iterator, item)}
    return method
