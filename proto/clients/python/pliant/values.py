"""Single values of a caller, judged before anything is sent.

What protobuf and numpy would turn into something else without a word (half a number into a whole one, text into
numbers, the imaginary part into nothing) is refused here, and what they refuse is said with its name.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt

_MOST = (1 << 32) - 1


@contextmanager
def about(what: str) -> Iterator[None]:
    """Says first what a TypeError or ValueError is about."""
    try:
        yield
    except TypeError as wrong:
        raise TypeError(f"{what}: {wrong}") from None
    except ValueError as wrong:
        raise ValueError(f"{what}: {wrong}") from None


def seen(value: Any) -> str:
    """A value as a message shows it: its beginning."""
    shown = " ".join(repr(value).split())
    return shown if len(shown) <= 80 else f"{shown[:77]}..."


def text(what: str, value: Any, allowed: str = "text") -> str:
    """A text."""
    if not isinstance(value, str):
        raise TypeError(f"{what}: {seen(value)}, {allowed} is allowed")
    return value


def flag(what: str, value: Any) -> bool:
    """True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{what}: {seen(value)}, True or False is allowed")
    return bool(value)


def number(what: str, value: Any) -> float:
    """A number; which ones are allowed is the server's to say."""
    array = np.asarray(value) if not isinstance(value, (str, bytes)) else None
    if array is None or array.ndim != 0 or array.dtype.kind not in "iuf":
        raise TypeError(f"{what}: {seen(value)}, a number is allowed")
    return float(value)


def whole(what: str, value: Any) -> int:
    """A whole number from 0."""
    exact = number(what, value)
    if not exact.is_integer() or not 0 <= exact <= _MOST:
        raise ValueError(f"{what}: {seen(value)}, a whole number from 0 to {_MOST} is allowed")
    return int(exact)


def array(what: str, value: Any) -> npt.NDArray[Any]:
    """Numbers of any shape, in the precision in which they are."""
    with about(what):
        found = np.asarray(value)
    if found.size and found.dtype.kind not in "iuf":
        raise ValueError(f"{what}: values of type {found.dtype}, real numbers are allowed")
    return found


def mapping(what: str, value: Any, allowed: str) -> Mapping[Any, Any]:
    """A dict or the like."""
    if not isinstance(value, Mapping):
        raise TypeError(f"{what}: {seen(value)}, {allowed} is allowed")
    return value


def snake_case(name: Any) -> Any:
    """A name as Python spells it: jobs and HTTP say halfSpace, Python says half_space."""
    return re.sub("(?<=[a-z0-9])[A-Z]", lambda found: "_" + found[0].lower(), name) if isinstance(name, str) else name


def put(message: Any, name: str, value: Any) -> None:
    """Sets a single field of a message, by what kind of field it is."""
    field = message.DESCRIPTOR.fields_by_name[name]
    judge = _KINDS.get(field.cpp_type)
    setattr(message, name, value if judge is None else judge(name, value))


# By FieldDescriptor.CPPTYPE_*: UINT32, DOUBLE, BOOL, STRING.
_KINDS: dict[int, Any] = {3: whole, 5: number, 7: flag, 9: text}


def float_points(name: str, value: Any, origin: Sequence[float] = ()) -> bytes:
    """Points, (n, 3), as the schema carries them: little-endian 32-bit floats, relative to a session's origin where it has one."""
    points = array(name, value)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"{name}: an array of shape {points.shape}, (n, 3) is allowed")
    if len(origin) == 3:
        points = points.astype(np.float64) - np.array(origin)
    return points.astype("<f4").tobytes()
