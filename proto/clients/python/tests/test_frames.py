"""Frames from parts: order, attributes, encodings, changed vertices, and what a broken server may send."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np
import pytest

from pliant.errors import Internal
from pliant.frames import Assembler, whole
from pliant.v1 import pliant_pb2 as pb
from pliant.vertex_codec import decode_steps


def part(number: int, parts: int, values: np.ndarray, **fields: object) -> pb.Frame:
    data = values.astype("<f4").tobytes()
    made = pb.Frame(seq=7, part=number, parts=parts, data=data, vertex_count=len(values), final=True)
    for name, value in fields.items():
        getattr(made, name).extend(value) if name in ("indices", "box_min", "box_max", "origin") else setattr(made, name, value)
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


def test_positions_far_away_are_doubles_in_model_space() -> None:
    points = np.array([[0.125, -0.25, 2.0], [1e-3, 0.0, -1.0]], np.float32)
    place = [523417.25, 5274863.5, 412.0]
    assembler = Assembler(2, changed_only=True)
    first = assembler.take(part(0, 1, points, indices=[0, 1], origin=place))
    assert first is not None and first.positions.dtype == np.float64
    assert np.array_equal(first.positions, points.astype(np.float64) + place)
    second = assembler.take(part(0, 1, points[:1] * 2, indices=[1], origin=place))
    assert second is not None
    assert np.array_equal(second.positions, points[[0, 0]] * np.float64([[1], [2]]) + place)


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
        ([part(0, 1, np.zeros((2, 3)), encoding=pb.Frame.MESHOPT)], "not a code of 2 vertices"),
        ([part(0, 1, np.zeros((2, 3)), encoding=pb.Frame.DELTA)], "does not name"),
        ([part(0, 1, np.zeros((2, 3)), encoding=9)], "not asked for"),
        ([part(0, 2, np.zeros((2, 3)))], "ended before the frame was whole"),
        ([part(0, 1, np.zeros((2, 3)), attribute=pb.Frame.NORMAL)], "no positions"),
        ([part(0, 1, np.zeros((2, 3)), attribute=9)], "number 9"),
        ([part(0, 0, np.zeros((2, 3)))], "says that there are 0"),
        ([part(0, 2, np.zeros((1, 3))), part(1, 3, np.zeros((1, 3)), first_vertex=1)], "says that there are 3"),
        ([part(0, 2, np.zeros((1, 3))), part(1, 2, np.zeros((1, 3)))], "at vertex 0 where 1 was due"),
        ([part(0, 1, np.zeros((1, 3)), first_vertex=1)], "at vertex 1 where 0 was due"),
        ([part(0, 1, np.zeros((1, 3)))], "has 1 of the model's 2 vertices; after an edit.*open a new stream"),
        ([part(0, 1, np.zeros((3, 3)))], "more than the model's 2 vertices; after an edit.*open a new stream"),
        (
            [part(0, 2, np.zeros((2, 3))), part(1, 2, np.zeros((1, 3)), attribute=pb.Frame.NORMAL)],
            "has 1 of the model's 2 vertices",
        ),
    ],
)
def test_an_answer_that_does_not_fit_the_model_is_told_of(parts: list[pb.Frame], words: str) -> None:
    with pytest.raises(Internal, match=words):
        whole(parts, 2, changed_only=False)


def codes() -> list[tuple[bytes, np.ndarray]]:
    """What meshoptimizer's encoder (npm, 1.3.0) makes of vertices, and these; ``vertex_codes.json`` tells how."""
    stored = json.loads((Path(__file__).parent / "vertex_codes.json").read_text())
    return [
        (base64.b64decode(code["code"]), np.frombuffer(base64.b64decode(code["steps"]), "<u2").reshape(-1, 4))
        for code in stored["codes"]
    ]


def test_the_vertex_codec_gives_back_what_was_packed() -> None:
    seen = codes()
    assert len(seen) > 20
    for code, steps in seen:
        assert np.array_equal(decode_steps(code, len(steps)), steps)


def test_bytes_that_are_no_code_are_refused_or_read_and_never_crash() -> None:
    draw = np.random.default_rng(3)
    for code, steps in codes():
        with pytest.raises(Internal):
            decode_steps(code[:-1], len(steps))
        for _ in range(20):
            broken = bytearray(code[: draw.integers(1, len(code) + 1)])
            broken[draw.integers(len(broken))] ^= 1 << int(draw.integers(8))
            try:
                decode_steps(bytes(broken), len(steps))
            except Internal:
                pass
    with pytest.raises(Internal):
        decode_steps(b"", 3)
    with pytest.raises(Internal):
        decode_steps(codes()[0][0], 1 << 31)


BOX: dict[str, object] = {"box_min": [-1, 0, 2], "box_max": [1, 4, 3], "number": 1}


def told(code: bytes, count: int, **fields: object) -> pb.Frame:
    """The one part of a frame that is packed so."""
    packed = {"encoding": pb.Frame.MESHOPT, "vertex_count": count, "data": code}
    return pb.Frame(**{"seq": 7, "parts": 1, **BOX, **packed, **fields})


def test_differences_add_up_to_whole_frames() -> None:
    code, steps = next((code, steps) for code, steps in codes() if len(steps) == 257 and steps.any())
    low, high = np.array([-1, 0, 2]), np.array([1, 4, 3])
    assembler = Assembler(257)
    for number in range(1, 5):
        encoding = pb.Frame.MESHOPT if number == 1 else pb.Frame.DELTA
        frame = assembler.take(told(code, 257, encoding=encoding, number=number))
        assert frame is not None
        wanted = (steps[:, :3].astype(np.uint32) * number % 65536).astype(np.uint16)
        assert np.array_equal(frame.positions, (low + wanted * ((high - low) / 65535)).astype(np.float32))
    # A part that did not compress stands for itself.
    frame = assembler.take(told(steps[:, :3].tobytes(), 257, encoding=pb.Frame.U16, number=5))
    assert frame is not None
    assert np.array_equal(frame.positions, (low + steps[:, :3] * ((high - low) / 65535)).astype(np.float32))


def test_parts_of_which_differences_are_told_are_of_one_frame_and_leave_no_holes() -> None:
    def half(k: int, number: int = 1, **fields: object) -> pb.Frame:
        numbers = np.full((2, 3), number, "<u2").tobytes()
        place = {"part": k, "parts": 2, "first_vertex": 2 * k, "encoding": pb.Frame.U16, "number": number}
        return told(numbers, 2, **{**place, **fields})

    def refused(words: str, *parts: pb.Frame, before: tuple[pb.Frame, ...] = ()) -> None:
        assembler = Assembler(4)
        for one in before:
            assembler.take(one)
        with pytest.raises(Internal, match=words):
            for one in parts:
                assembler.take(one)

    refused("in another 50", half(0), half(1, number=50))
    refused("in another 0", half(0), half(1, number=0))
    refused("several boxes", half(0), half(1, box_max=[1, 4, 4]))
    refused("at vertex 0 where 2 was due", half(0), half(1, first_vertex=0))
    refused("more than the model's 4 vertices", half(0), half(1, first_vertex=3))
    refused("more than the model's 4 vertices", half(0, first_vertex=2**32 - 1))
    refused("2 of the model's 4", half(0, parts=1))
    # Nothing is told from a box that the frame before did not have.
    code = bytes([0xA1, 0xAA, 0xAA]) + bytes(24)
    delta: dict[str, object] = {"encoding": pb.Frame.DELTA, "data": code, "number": 2}
    key = (half(0), half(1))
    other: dict[str, object] = {"box_max": [9, 9, 9]}
    refused("not here", half(0, 2, **other), half(1, **{**delta, **other}), before=key)
    # A part that stands for itself leaves the others what they are told from.
    assembler = Assembler(4)
    frames = [assembler.take(one) for one in (*key, half(0, 2), half(1, **delta))]
    assert frames[3] is not None
    low, high = np.array([-1, 0, 2]), np.array([1, 4, 3])
    steps = np.array([2, 2, 1, 1])[:, None]
    assert np.array_equal(frames[3].positions, (low + steps * ((high - low) / 65535)).astype(np.float32))


@pytest.mark.parametrize(
    "fields",
    [
        {"number": 3},
        {"box_max": [1, 4, 4]},
        {"attribute": pb.Frame.NORMAL},
        {"indices": [1]},
        {"vertex_count": 256},
        {"first_vertex": 1},
        {"encoding": pb.Frame.F32},
        {"data": b"\xa1"},
    ],
)
def test_differences_without_what_they_are_told_from_are_refused(fields: dict[str, object]) -> None:
    code, _ = next((code, steps) for code, steps in codes() if len(steps) == 257)
    assembler = Assembler(257)
    with pytest.raises(Internal, match="not here"):
        assembler.take(told(code, 257, encoding=pb.Frame.DELTA, number=2))
    assert assembler.take(told(code, 257)) is not None
    with pytest.raises(Internal):
        assembler.take(told(code, 257, **{"encoding": pb.Frame.DELTA, "number": 2, **fields}))
    # Nothing is told from what was refused, and nothing from the frame of a connection that is lost.
    with pytest.raises(Internal):
        assembler.take(told(code, 257, encoding=pb.Frame.DELTA, number=2))
    assert assembler.take(told(code, 257)) is not None
    assembler.restart()
    with pytest.raises(Internal, match="not here"):
        assembler.take(told(code, 257, encoding=pb.Frame.DELTA, number=2))


def test_gradients_are_rotation_times_stretch() -> None:
    points = np.zeros((2, 3), np.float32)
    half = np.sqrt(0.5)
    quarter = np.array([[0, 0, half, half], [0, 0, 0, 1]], np.float32)  # a quarter turn about z, and none
    stretches = np.array([[2, 1, 1], [1, 1, 3]], np.float32)
    shears = np.array([[0, 0, 0], [0, 0, 0.5]], np.float32)
    frame = whole(
        [
            part(0, 4, points),
            part(1, 4, quarter, attribute=pb.Frame.ROTATION),
            part(2, 4, stretches, attribute=pb.Frame.STRETCH),
            part(3, 4, shears, attribute=pb.Frame.SHEAR),
        ],
        2,
        changed_only=False,
    )
    first, second = frame.gradients()
    assert np.allclose(first, [[0, -1, 0], [2, 0, 0], [0, 0, 1]], atol=1e-6)
    assert np.allclose(second, [[1, 0.5, 0], [0.5, 1, 0], [0, 0, 3]], atol=1e-6)
    with pytest.raises(ValueError, match="gradients=True"):
        whole([part(0, 1, points)], 2, changed_only=False).gradients()
