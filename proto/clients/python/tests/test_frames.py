"""Frames from parts: order, attributes, encodings, changed vertices, and what a broken server may send."""

from __future__ import annotations

import numpy as np
import pytest

from pliant.errors import Internal
from pliant.frames import Assembler, whole
from pliant.v1 import pliant_pb2 as pb


def part(number: int, parts: int, values: np.ndarray, **fields: object) -> pb.Frame:
    data = values.astype("<f4").tobytes()
    made = pb.Frame(seq=7, part=number, parts=parts, data=data, vertex_count=len(values), final=True)
    for name, value in fields.items():
        getattr(made, name).extend(value) if name in ("indices", "box_min", "box_max") else setattr(made, name, value)
    return made


def test_parts_and_attributes_become_one_frame() -> None:
    points = np.arange(30, dtype=np.float32).reshape(10, 3)
    tangents = np.ones((10, 4), np.float32)
    frame = whole(
        [
            part(0, 4, points[:6]),
            part(1, 4, points[6:], first_vertex=6),
            part(2, 4, -points, attribute=pb.Frame.NORMAL),
            part(3, 4, tangents, attribute=pb.Frame.TANGENT),
        ],
        10,
        changed_only=False,
    )
    assert np.array_equal(frame.positions, points) and frame.positions.dtype == np.float32
    assert frame.normals is not None and np.array_equal(frame.normals, -points)
    assert frame.tangents is not None and np.array_equal(frame.tangents, tangents)
    assert frame.seq == 7 and frame.changed is None and frame.quality is None


def test_changes_apply_to_what_came_before_and_frames_are_the_callers_own() -> None:
    points = np.arange(12, dtype=np.float32).reshape(4, 3)
    assembler = Assembler(4, changed_only=True)
    first = assembler.take(part(0, 1, points, indices=[0, 1, 2, 3]))
    assert first is not None
    first.positions[:] = -1  # the caller may write to it
    second = assembler.take(part(0, 1, points[[0, 1]] * 10, indices=[1, 3]))
    assert second is not None and second.changed is not None
    assert second.changed.tolist() == [1, 3]
    assert np.array_equal(second.positions, [points[0], points[0] * 10, points[2], points[1] * 10])
    nothing = assembler.take(part(0, 1, points[:0]))
    assert nothing is not None and nothing.changed is not None and nothing.changed.size == 0
    assert np.array_equal(nothing.positions, second.positions)


def test_sixteen_bits_come_back_within_half_a_step() -> None:
    numbers = np.array([[0, 0, 0], [65535, 32768, 1]], "<u2")
    packed = pb.Frame(
        seq=1,
        parts=1,
        data=numbers.tobytes(),
        vertex_count=2,
        encoding=pb.Frame.U16,
        box_min=[-1, 0, 2],
        box_max=[1, 4, 3],
    )
    frame = whole([packed], 2, changed_only=False)
    assert np.allclose(frame.positions, [[-1, 0, 2], [1, 4 * 32768 / 65535, 2 + 1 / 65535]])


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ([part(1, 2, np.zeros((2, 3)))], "part 0 of 7 was due"),
        ([part(0, 1, np.zeros((3, 3)))], "more than the model's 2"),
        ([part(0, 1, np.zeros((1, 3)), first_vertex=2)], "more than the model's 2"),
        ([part(0, 1, np.zeros((1, 3)), indices=[5])], "does not have"),
        ([part(0, 1, np.zeros((2, 3)), indices=[0])], "does not have"),
        ([part(0, 1, np.zeros((2, 2)))], "bytes for 2 vertices"),
        ([part(0, 1, np.zeros((2, 3)), encoding=pb.Frame.MESHOPT)], "not asked for"),
        ([part(0, 2, np.zeros((2, 3)))], "ended before the frame was whole"),
        ([part(0, 1, np.zeros((2, 3)), attribute=pb.Frame.NORMAL)], "no positions"),
    ],
)
def test_an_answer_that_does_not_fit_the_model_is_told_of(parts: list[pb.Frame], words: str) -> None:
    with pytest.raises(Internal, match=words):
        whole(parts, 2, changed_only=False)
