"""Frames: solved vertex buffers, put together from the parts in which they travel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import Internal
from .v1 import pliant_pb2 as pb

Floats = npt.NDArray[np.float32]

_NUMBERS = {pb.Frame.POSITION: 3, pb.Frame.NORMAL: 3, pb.Frame.TANGENT: 4}


@dataclass(frozen=True, eq=False)
class Frame:
    """A solved vertex buffer. The arrays are the caller's to keep and to write to."""

    #: The pose that it answers.
    seq: int
    #: The session's revision after it.
    revision: int
    #: (render vertices, 3).
    positions: Floats
    #: (render vertices, 3), where asked for.
    normals: Floats | None
    #: (render vertices, 4), where asked for; zeros for primitives without tangents.
    tangents: Floats | None
    #: With ``changed_only``: the render vertices that this frame brought, ascending. The arrays are whole all the same.
    changed: npt.NDArray[np.uint32] | None
    #: No better frame for this pose will follow.
    final: bool
    #: Relative residual reached.
    residual: float
    #: Estimate of the largest displacement still missing, as a fraction of the diagonal.
    max_error: float
    #: Milliseconds of solving.
    solve_ms: float
    #: Milliseconds of waiting for a compute slot.
    queue_ms: float
    #: Poses skipped since the previous frame because a newer one came.
    superseded: int
    #: Of a committed pose: the shape against the rest shape. Where it is never missing, frames are :class:`SolvedFrame`.
    quality: pb.Quality | None


@dataclass(frozen=True, eq=False)
class SolvedFrame(Frame):
    """The frame of a recorded pose."""

    #: The shape against the rest shape.
    quality: pb.Quality


def solved(frame: Frame) -> SolvedFrame:
    """A frame of a pose that was recorded."""
    if frame.quality is None:
        raise Internal(f"frame {frame.seq} of a recorded pose says nothing of its quality")
    return SolvedFrame(**frame.__dict__)


class Assembler:
    """Puts the parts of one stream's frames together.

    With ``changed_only`` it holds the buffers to which the changes apply; they stay valid when the stream is opened
    anew, since a new stream begins with all vertices.
    """

    def __init__(self, vertices: int, *, changed_only: bool = False) -> None:
        self._vertices = vertices
        self._sparse = changed_only
        self._held: dict[int, Floats] = {}
        self._changed: list[npt.NDArray[np.uint32]] = []
        self._under_way: tuple[int, int] | None = None  # seq and the number of the next part

    def restart(self) -> None:
        """Forgets a frame of which not all parts came."""
        self._under_way = None
        self._changed = []

    def take(self, part: pb.Frame) -> Frame | None:
        """Takes the next part; answers the frame when it was the last one."""
        expected = (part.seq, 0) if self._under_way is None else self._under_way
        if (part.seq, part.part) != expected:
            raise Internal(
                f"part {part.part} of frame {part.seq} came where part {expected[1]} of {expected[0]} was due"
            )
        self._place(part)
        if part.part + 1 < part.parts:
            self._under_way = (part.seq, part.part + 1)
            return None
        self._under_way = None
        return self._finish(part)

    def _place(self, part: pb.Frame) -> None:
        if part.part == 0 and not self._sparse:
            self._held = {}
        count, width = part.vertex_count, _NUMBERS[part.attribute]
        values = _decode(part, count, width)
        buffer = self._held.get(part.attribute)
        if buffer is None:
            # A whole frame fills every place of its positions and normals; tangents may leave primitives out.
            buffer = self._held[part.attribute] = np.zeros((self._vertices, width), np.float32)
        if part.indices:
            indices = np.fromiter(part.indices, np.uint32, len(part.indices))
            if indices.size != count or int(indices.max()) >= self._vertices:
                raise Internal(f"frame {part.seq} names vertices that the model does not have")
            buffer[indices] = values
            if part.attribute == pb.Frame.POSITION:
                self._changed.append(indices)
        else:
            if part.first_vertex + count > self._vertices:
                raise Internal(f"frame {part.seq} has more than the model's {self._vertices} vertices")
            buffer[part.first_vertex : part.first_vertex + count] = values

    def _finish(self, last: pb.Frame) -> Frame:
        def buffer(attribute: int) -> Floats | None:
            held = self._held.get(attribute)
            return held.copy() if held is not None and self._sparse else held

        positions = buffer(pb.Frame.POSITION)
        if positions is None:
            raise Internal(f"frame {last.seq} carries no positions")
        changed = None
        if self._sparse:
            changed = np.concatenate(self._changed) if self._changed else np.empty(0, np.uint32)
            self._changed = []
        return Frame(
            seq=last.seq,
            revision=last.revision,
            positions=positions,
            normals=buffer(pb.Frame.NORMAL),
            tangents=buffer(pb.Frame.TANGENT),
            changed=changed,
            final=last.final,
            residual=last.residual,
            max_error=last.max_error,
            solve_ms=last.solve_ms,
            queue_ms=last.queue_ms,
            superseded=last.superseded,
            quality=last.quality if last.HasField("quality") else None,
        )


def _decode(part: pb.Frame, count: int, width: int) -> npt.NDArray[Any]:
    """The numbers of a part, (count, width)."""
    if part.encoding == pb.Frame.F32:
        kind: npt.DTypeLike = "<f4"
    elif part.encoding == pb.Frame.U16:
        kind = "<u2"
    else:
        raise Internal(f"frame {part.seq} is packed in a way (number {part.encoding}) that was not asked for")
    values = np.frombuffer(part.data, kind)
    if values.size != count * width:
        raise Internal(f"part {part.part} of frame {part.seq} has {len(part.data)} bytes for {count} vertices")
    values = values.reshape(count, width)
    if part.encoding == pb.Frame.F32:
        return values
    if part.attribute == pb.Frame.POSITION:
        low, high = np.array(part.box_min), np.array(part.box_max)
    else:
        low, high = np.full(width, -1.0), np.full(width, 1.0)
    scaled: npt.NDArray[Any] = low + values * ((high - low) / 65535)
    return scaled


def whole(parts: Any, vertices: int, *, changed_only: bool) -> Frame:
    """The frame of a call that answers exactly one."""
    assembler = Assembler(vertices, changed_only=changed_only)
    frame = None
    for part in parts:
        frame = assembler.take(part)
    if frame is None:
        raise Internal("the answer ended before the frame was whole")
    return frame
