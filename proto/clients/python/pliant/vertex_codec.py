"""meshoptimizer's vertex codec, versions 0 and 1, for vertices of four 16-bit numbers: how MESHOPT and DELTA frames are packed.

The format is that of meshoptimizer's ``meshopt_decodeVertexBuffer``, which EXT_meshopt_compression and KHR_meshopt_compression
describe. The bytes before each group of bytes say where it begins, so the groups are found one by one; all else is numpy's.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt

from .errors import Internal

Steps = npt.NDArray[np.uint16]
_Bytes = npt.NDArray[np.uint8]

_Whole = TypeVar("_Whole", np.uint8, np.uint16)

#: Bytes of a vertex.
_STRIDE = 8
#: Vertices of a block, and of a group in it, whose bytes are packed alike.
_BLOCK, _GROUP = 256, 16
#: Bits of a byte by the two bits of its group: of version 0, and of version 1 by the mode of the plane.
_BITS_V0 = (0, 2, 4, 8)
_BITS_V1 = ((0, 1, 2, 4), (1, 2, 4, 8))


def _wholes(width: int) -> bytes:
    """How many of the numbers of `width` bits in a byte are the highest, which stands for a whole byte behind them."""
    whole = (1 << width) - 1
    return bytes(sum(byte >> shift & whole == whole for shift in range(0, 8, width)) for byte in range(256))


_WHOLES = {width: _wholes(width) for width in (1, 2, 4)}
#: Where the numbers of a byte are, in order: from the lowest bit on where they are single, else from the highest.
_SHIFTS = {1: np.arange(8), 2: np.array([6, 4, 2, 0]), 4: np.array([4, 0])}


class _Broken(Exception):
    """Bytes that are not such a code."""


def decode_steps(data: bytes, count: int) -> Steps:
    """The numbers of `count` vertices, (count, 4)."""
    try:
        return _decode(data, count)
    except (_Broken, IndexError) as broken:
        raise Internal(f"a part of a frame is not a code of {count} vertices") from broken


def _decode(data: bytes, count: int) -> Steps:
    version = data[0] - 0xA0
    if version not in (0, 1):
        raise _Broken
    # Behind the blocks: what differences of the first vertex are told from, and in version 1 how each pair of numbers is told.
    tail = len(data) - (_STRIDE if version == 0 else _STRIDE + 2)
    end = len(data) - (32 if version == 0 else 24)
    # A vertex takes a tenth of a bit at least: no more are made than the bytes could mean.
    if end < 1 or count > 128 * len(data):
        raise _Broken
    blocks = -(-count // _BLOCK)
    planes = np.zeros((_STRIDE, blocks * _BLOCK), np.uint8)
    groups = _places(data, count, version, end, planes)
    source = np.frombuffer(data, np.uint8)
    flat = planes.reshape(-1, _GROUP)
    for width, found in groups.items():
        if found:
            begins, slots = np.array(found, np.intp).T
            flat[slots] = _group(source, begins, width)
    channels = (0, 0) if version == 0 else (data[-2], data[-1])
    numbers = np.empty((count, 4), np.uint16)
    for pair, channel in enumerate(channels):
        _pair(
            planes[4 * pair : 4 * pair + 4, :count],
            source[tail + 4 * pair : tail + 4 * pair + 4],
            channel,
            numbers[:, 2 * pair :],
        )
    return numbers


def _places(data: bytes, count: int, version: int, end: int, planes: _Bytes) -> dict[int, list[tuple[int, int]]]:
    """Where groups begin and the slots that they fill, by the width of their numbers. What is not packed goes to its plane."""
    found: dict[int, list[tuple[int, int]]] = {1: [], 2: [], 4: [], 8: []}
    at = 1
    slots = planes.shape[1] // _GROUP
    for first in range(0, count, _BLOCK):
        vertices = min(_BLOCK, count - first)
        many = -(-vertices // _GROUP)
        controls = at
        at += 0 if version == 0 else 2
        for plane in range(_STRIDE):
            mode = 0 if version == 0 else data[controls + plane // 4] >> (plane % 4 * 2) & 3
            if mode == 2:
                continue
            if mode == 3:
                if at + vertices > end:
                    raise _Broken
                planes[plane, first : first + vertices] = np.frombuffer(data, np.uint8, vertices, at)
                at += vertices
                continue
            widths = _BITS_V0 if version == 0 else _BITS_V1[mode]
            heads = at
            at += -(-many // 4)
            slot = plane * slots + first // _GROUP
            for group in range(many):
                width = widths[data[heads + group // 4] >> (group % 4 * 2) & 3]
                if width == 0:
                    continue
                found[width].append((at, slot + group))
                if width == 8:
                    at += _GROUP
                else:
                    small = data[at : at + 2 * width]
                    at += 2 * width + sum(small.translate(_WHOLES[width]))
            if at > end:
                raise _Broken
    if at != end:
        raise _Broken
    return found


def _group(source: _Bytes, begins: npt.NDArray[np.intp], width: int) -> _Bytes:
    """The bytes of groups that begin there, (groups, 16)."""
    if width == 8:
        plain: _Bytes = source[begins[:, None] + np.arange(_GROUP)]
        return plain
    small = source[begins[:, None] + np.arange(2 * width)]
    whole = (1 << width) - 1
    values: _Bytes = (small[:, :, None] >> _SHIFTS[width] & whole).reshape(-1, _GROUP).astype(np.uint8)
    is_whole = values == whole
    more = begins[:, None] + 2 * width + np.cumsum(is_whole, axis=1) - 1
    values[is_whole] = source[more[is_whole]]
    return values


def _pair(planes: _Bytes, before: _Bytes, channel: int, out: Steps) -> None:
    """Two numbers of each vertex, from their four planes and the start values of the first vertex."""
    kind = channel & 3
    if kind == 0:
        bytes_ = _unzigzag(planes)
        bytes_[:, :1] += before[:, None]
        bytes_ = np.cumsum(bytes_, axis=1, dtype=np.uint8)
        out[:, 0] = bytes_[0] | bytes_[1].astype(np.uint16) << 8
        out[:, 1] = bytes_[2] | bytes_[3].astype(np.uint16) << 8
    elif kind == 1:
        wide = planes.astype(np.uint16)
        for k in range(2):
            told = _unzigzag(wide[2 * k] | wide[2 * k + 1] << 8)
            told[:1] += before[2 * k].astype(np.uint16) | before[2 * k + 1].astype(np.uint16) << 8
            out[:, k] = np.cumsum(told, dtype=np.uint16)
    elif kind == 2:
        long = planes.astype(np.uint32)
        told = long[0] | long[1] << 8 | long[2] << 16 | long[3] << 24
        turn = channel >> 4
        if turn:
            told = told >> turn | told << (32 - turn)
        told[:1] ^= np.uint32(int.from_bytes(before.tobytes(), "little"))
        told = np.bitwise_xor.accumulate(told)
        out[:, 0], out[:, 1] = told & 0xFFFF, told >> 16
    else:
        raise _Broken


def _unzigzag(values: npt.NDArray[_Whole]) -> npt.NDArray[_Whole]:
    """Differences modulo the size of their numbers; odd ones are below zero."""
    signs = (values & 1) * values.dtype.type(-1 % (1 << 8 * values.itemsize))
    told: npt.NDArray[_Whole] = (values // 2 ^ signs).astype(values.dtype)
    return told
