"""Frames: solved vertex buffers, put together from the parts in which they travel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import Internal
from .v1 import pliant_pb2 as pb
from .vertex_codec import Steps, decode_steps

Floats = npt.NDArray[np.float32]
#: float32, or float64 far from the origin (map coordinates), where 32 bits would round them.
Positions = npt.NDArray[np.floating[Any]]

#: What is behind frames that have another number of vertices.
_EDITED = "after an edit, its undo or redo, open a new stream"

_NUMBERS = {
    pb.Frame.POSITION: 3,
    pb.Frame.NORMAL: 3,
    pb.Frame.TANGENT: 4,
    pb.Frame.ROTATION: 4,
    pb.Frame.STRETCH: 3,
    pb.Frame.SHEAR: 3,
}
#: Steps of these lie between -4 and 4, of other directions between -1 and 1.
_STRETCHES = (pb.Frame.STRETCH, pb.Frame.SHEAR)


@dataclass(frozen=True, eq=False, repr=False)
class Frame:
    """A solved vertex buffer. The arrays are the caller's to keep and to write to."""

    #: The pose that it answers.
    seq: int
    #: The session's revision after it.
    revision: int
    #: (render vertices, 3), in model space: float64 where the session has an origin, else float32.
    positions: Positions
    #: (render vertices, 3), where asked for.
    normals: Floats | None
    #: (render vertices, 4), where asked for; zeros for primitives without tangents (with packed encodings about 1.5e-5,
    #: which is next to zero among their steps).
    tangents: Floats | None
    #: (render vertices, 4), with ``gradients``: unit quaternions x, y, z, w, by which space around each vertex has turned.
    rotations: Floats | None
    #: (render vertices, 3), with ``gradients``: xx, yy and zz of the symmetric stretch there.
    stretches: Floats | None
    #: (render vertices, 3), with ``gradients``: yz, zx and xy of the symmetric stretch there.
    shears: Floats | None
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
    #: The rotations found for handles that turn freely, by id, as axis times angle; in final frames.
    found_turns: Mapping[str, tuple[float, float, float]]

    def __repr__(self) -> str:
        kind = "final" if self.final else "on the way"
        facts = f"revision {self.revision}, {kind}, residual {self.residual:.2g}, {self.solve_ms:.1f} ms"
        return f"<pliant.{type(self).__name__} {self.seq}: {len(self.positions)} vertices, {facts}>"

    def gradients(self) -> Floats:
        """The gradient of the motion around each vertex, (render vertices, 3, 3): a covariance ``C`` of a splat becomes ``G C G^T``.

        Raises ``ValueError`` where the frame was not asked for ``gradients``.
        """
        if self.rotations is None or self.stretches is None or self.shears is None:
            raise ValueError("the frame carries no gradients; ask for gradients=True")
        x, y, z, w = self.rotations.T
        turns = np.stack(
            [
                1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
                2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
                2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
            ],
            axis=-1,
        ).reshape(-1, 3, 3)  # fmt: skip
        (xx, yy, zz), (yz, zx, xy) = self.stretches.T, self.shears.T
        stretches = np.stack([xx, xy, zx, xy, yy, yz, zx, yz, zz], axis=-1).reshape(-1, 3, 3)
        gradients: Floats = turns @ stretches
        return gradients


@dataclass(frozen=True, eq=False, repr=False)
class SolvedFrame(Frame):
    """The frame of a recorded pose."""

    #: The shape against the rest shape.
    quality: pb.Quality


def solved(frame: Frame) -> SolvedFrame:
    """A frame of a pose that was recorded."""
    if frame.quality is None:
        raise Internal(f"frame {frame.seq} of a recorded pose has no quality")
    return SolvedFrame(**frame.__dict__)


class Assembler:
    """Puts the parts of one stream's frames together.

    With ``changed_only`` it holds the buffers to which the changes apply; they stay valid when the stream is opened
    again, since a new stream begins with all vertices. With ``encoding="delta"`` it holds the steps of the frame before, which are
    those of one connection.
    """

    def __init__(self, vertices: int, *, changed_only: bool = False) -> None:
        self._vertices = vertices
        self._sparse = changed_only
        self._held: dict[int, Floats] = {}
        self._changed: list[npt.NDArray[np.uint32]] = []
        # The part before, where it was not the last of its frame, and how many vertices of each attribute have come.
        self._before: pb.Frame | None = None
        self._carried: dict[int, int] = {}
        # Of frames that differences may be told from: the number of the last whole one, its steps, and its box.
        self._number: int | None = None
        self._steps: dict[int, Steps] = {}
        self._box: list[float] = []
        self._next_box: list[float] = []

    def restart(self) -> None:
        """Forgets an incomplete frame, and the base of the differences of a lost connection."""
        self._before = None
        self._changed = []
        self._number = None
        self._steps = {}

    def take(self, part: pb.Frame) -> Frame | None:
        """Takes the next part; answers the frame when it was the last one."""
        before, self._before = self._before, None
        base, self._number = self._number, None
        expected = (part.seq, 0) if before is None else (before.seq, before.part + 1)
        if (part.seq, part.part) != expected:
            raise Internal(
                f"part {part.part} of frame {part.seq} came where part {expected[1]} of {expected[0]} was due"
            )
        _check_with(part, before or part)
        if before is None:
            self._carried = {}
        self._place(part, base)
        if part.part + 1 < part.parts:
            self._before = part
            self._number = base
            return None
        if not self._sparse:
            self._check_whole(part)
        if part.number:
            self._number, self._box = part.number, self._next_box
        # Differences are told of what the frame before carried, and of nothing else.
        self._steps = {attribute: steps for attribute, steps in self._steps.items() if attribute in self._carried}
        return self._finish(part)

    def _check_whole(self, last: pb.Frame) -> None:
        """A frame of everything has every vertex of all that it carries: nothing of the one before shows through."""
        for count in self._carried.values():
            if count < self._vertices:
                raise Internal(f"frame {last.seq} has {count} of the model's {self._vertices} vertices; {_EDITED}")

    def _place(self, part: pb.Frame, base: int | None) -> None:
        if part.part == 0 and not self._sparse:
            self._held = {}
        count, width, come = part.vertex_count, _NUMBERS.get(part.attribute), self._carried.get(part.attribute, 0)
        if width is None:
            raise Internal(f"frame {part.seq} carries something (number {part.attribute}) that was not asked for")
        if max(part.first_vertex, come) + count > self._vertices:
            raise Internal(f"frame {part.seq} has more than the model's {self._vertices} vertices; {_EDITED}")
        if not self._sparse and not part.indices and part.first_vertex != come:
            raise Internal(f"frame {part.seq} continues at vertex {part.first_vertex} where {come} was due")
        values = self._added(part, count, width, base) if part.number else _decode(part, count, width)
        buffer = self._held.get(part.attribute)
        if buffer is None:
            buffer = self._held[part.attribute] = np.zeros((self._vertices, width), np.float32)
        if part.indices:
            indices = np.fromiter(part.indices, np.uint32, len(part.indices))
            if indices.size != count or int(indices.max()) >= self._vertices:
                raise Internal(f"frame {part.seq} names vertices that the model does not have")
            buffer[indices] = values
            if part.attribute == pb.Frame.POSITION:
                self._changed.append(indices)
        else:
            buffer[part.first_vertex : part.first_vertex + count] = values
        self._carried[part.attribute] = come + count

    def _added(self, part: pb.Frame, count: int, width: int, base: int | None) -> npt.NDArray[Any]:
        """The numbers of a part that later frames may refer to, or that is itself coded as differences."""
        attribute, first, box = part.attribute, part.first_vertex, [*part.box_min, *part.box_max]
        if self._sparse or part.indices or part.encoding == pb.Frame.F32:
            raise Internal(f"frame {part.seq} cannot be one that later frames refer to")
        if attribute == pb.Frame.POSITION:
            if attribute in self._carried and box != self._next_box:
                raise Internal(f"frame {part.seq} says in its parts that its numbers lie in several boxes")
            self._next_box = box
        steps = _steps(part, count, width)
        if part.encoding == pb.Frame.DELTA:
            held = self._steps.get(attribute)
            is_there = base == part.number - 1 and held is not None
            if held is None or not is_there or (attribute == pb.Frame.POSITION and box != self._box):
                raise Internal(
                    f"frame {part.seq} lists what differs from the frame before, which is not here; "
                    "open a new stream, which begins with a whole frame"
                )
            steps = steps + held[first : first + count, :width]
        held = self._steps.get(attribute)
        if held is None:
            held = self._steps[attribute] = np.zeros((self._vertices, 4), np.uint16)
        held[first : first + count, :width] = steps
        return _scaled(part, steps, width)

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
            positions=in_model_space(positions, last.origin),
            normals=buffer(pb.Frame.NORMAL),
            tangents=buffer(pb.Frame.TANGENT),
            rotations=buffer(pb.Frame.ROTATION),
            stretches=buffer(pb.Frame.STRETCH),
            shears=buffer(pb.Frame.SHEAR),
            changed=changed,
            final=last.final,
            residual=last.residual,
            max_error=last.max_error,
            solve_ms=last.solve_ms,
            queue_ms=last.queue_ms,
            superseded=last.superseded,
            quality=last.quality if last.HasField("quality") else None,
            found_turns={turn.id: (x, y, z) for turn in last.found_turns for x, y, z in [turn.rotation_vector]},
        )


def in_model_space(positions: Floats, origin: Sequence[float]) -> Positions:
    """Positions that came relative to `origin`; as they are where there is none."""
    return positions.astype(np.float64) + np.array(origin) if len(origin) == 3 else positions


def _check_with(part: pb.Frame, before: pb.Frame) -> None:
    """What every part of a frame says is the same in all of them, and there is one at least."""
    if part.part >= part.parts or part.parts != before.parts:
        raise Internal(f"part {part.part} of frame {part.seq} says that there are {part.parts}")
    if part.number != before.number:
        numbers = f"{before.number}, in another {part.number}"
        raise Internal(f"frame {part.seq} says in one part that its number is {numbers}")


def _decode(part: pb.Frame, count: int, width: int) -> npt.NDArray[Any]:
    """The numbers of a part that stands for itself, (count, width)."""
    if part.encoding == pb.Frame.F32:
        return _values(part, "<f4", count, width)
    if part.encoding == pb.Frame.DELTA:
        raise Internal(f"frame {part.seq} lists what differs from a frame that it does not name")
    return _scaled(part, _steps(part, count, width), width)


def _values(part: pb.Frame, kind: npt.DTypeLike, count: int, width: int) -> npt.NDArray[Any]:
    values = np.frombuffer(part.data, np.uint8)
    if values.size != count * width * np.dtype(kind).itemsize:
        raise Internal(f"part {part.part} of frame {part.seq} has {len(part.data)} bytes for {count} vertices")
    return values.view(kind).reshape(count, width)


def _steps(part: pb.Frame, count: int, width: int) -> npt.NDArray[np.uint16]:
    """The steps of a part, or how far they are from others, (count, width)."""
    if part.encoding == pb.Frame.U16:
        return _values(part, "<u2", count, width)
    if part.encoding not in (pb.Frame.MESHOPT, pb.Frame.DELTA):
        raise Internal(f"frame {part.seq} is packed in a way (number {part.encoding}) that was not asked for")
    if count == 0:
        return np.empty((0, width), np.uint16)
    return decode_steps(part.data, count)[:, :width]


def _scaled(part: pb.Frame, steps: npt.NDArray[np.uint16], width: int) -> npt.NDArray[Any]:
    if part.attribute == pb.Frame.POSITION:
        if len(part.box_min) != 3 or len(part.box_max) != 3:
            raise Internal(f"frame {part.seq} does not say which box its steps lie in")
        low, high = np.array(part.box_min), np.array(part.box_max)
    else:
        high = np.full(width, 4.0 if part.attribute in _STRETCHES else 1.0)
        low = -high
    scaled: npt.NDArray[Any] = low + steps * ((high - low) / 65535)
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
