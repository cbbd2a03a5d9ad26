"""Dragging: a frame for every pose, the newest pose wins, changed vertices only, commits among it."""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import pliant
from pliant.server import find_binary

POSES = [{"head": {"rotation_vector": (0, 0.8 * k / 30, 0)}} for k in range(1, 31)]


@pytest.fixture
def held(server: pliant.LocalServer, creature: Path) -> Iterator[pliant.Session]:
    with pliant.open(creature, server=server) as session:
        session.handle("feet", half_space=((0, -1, 0), -0.14))
        session.handle("head", sphere=((0.76, 1.22, 0), 0.36))
        yield session


def head(positions: np.ndarray, rest: np.ndarray) -> np.ndarray:
    return positions[np.linalg.norm(rest - [0.76, 1.22, 0], axis=1) < 0.36]


def test_every_pose_is_answered_in_order(held: pliant.Session) -> None:
    rest = held.positions()
    frames = list(held.drag(POSES))
    assert [f.seq for f in frames] == list(range(1, 31))
    assert all(f.final and f.superseded == 0 for f in frames)
    moves = [np.abs(f.positions - rest).max() for f in frames]
    assert all(a < b for a, b in zip(moves, moves[1:])), "the head turns further with every pose"
    assert np.array_equal(held.positions(), rest), "a drag commits nothing"
    assert len(held.history()) == 2


def test_the_last_pose_or_every_pose_is_recorded_on_demand(held: pliant.Session) -> None:
    frames = list(held.drag(POSES[:5], commit="last"))
    assert len(frames) == 5 and frames[-1].quality is not None
    assert [c.kind for c in held.history()] == ["create", "handles", "pose"]
    assert np.array_equal(held.positions(), frames[-1].positions)
    alone = held.solve(POSES[4])
    assert np.array_equal(alone, frames[-1].positions), "what was dragged before does not matter"
    list(held.drag(POSES[:3], commit=True))
    assert [c.kind for c in held.history()][-3:] == ["pose"] * 3


def test_leaving_a_drag_early_leaves_the_session_as_it_was(held: pliant.Session) -> None:
    for frame in held.drag(POSES):
        if frame.seq == 3:
            break
    held.solve(POSES[0])


def test_the_newest_pose_wins_and_the_books_add_up(held: pliant.Session) -> None:
    rest = held.positions()
    many = [{"head": {"rotation_vector": (0, 0.8 * k / 300, 0)}} for k in range(1, 301)]
    frames = list(held.drag(many, latest=True, tolerance=1e-8))
    assert frames[-1].seq == 300 and frames[-1].final
    assert len(frames) + sum(f.superseded for f in frames) == 300
    wanted = held.solve(many[-1], tolerance=1e-8, refine=0)
    assert np.allclose(frames[-1].positions, wanted, atol=1e-4 * np.ptp(rest))


def test_poses_that_wait_are_skipped_for_newer_ones(held: pliant.Session) -> None:
    with held.stream(window=2) as stream:
        # Acknowledgements follow the poses, so that at most two frames can leave before the last pose has come.
        for k in range(1, 301):
            stream.send({"head": {"rotation_vector": (0, 0.8 * k / 300, 0)}})
        stream.finish()
        frames = list(stream)
    assert frames[-1].seq == 300 and len(frames) <= 4
    assert len(frames) + sum(f.superseded for f in frames) == 300


def test_an_iterator_that_fails_fails_the_drag(held: pliant.Session) -> None:
    def broken() -> Iterator[pliant.poses.Poses]:
        yield POSES[0]
        raise RuntimeError("the mouse is gone")

    for latest in (False, True):
        with pytest.raises(RuntimeError, match="mouse"):
            list(held.drag(broken(), latest=latest))


def test_changed_vertices_alone_make_whole_frames(held: pliant.Session) -> None:
    held.handle("tail", sphere=((-1.0, 1.06, 0), 0.16))
    rest = held.positions()
    whole = list(held.drag(POSES[:8], tolerance=1e-9))
    sparse = list(held.drag(POSES[:8], tolerance=1e-9, changed_only=1e-4))
    diagonal = np.linalg.norm(np.ptp(rest, axis=0))
    for a, b in zip(whole, sparse, strict=True):
        assert np.linalg.norm(a.positions - b.positions, axis=1).max() <= 2e-4 * diagonal
    assert sparse[0].changed is not None and len(sparse[0].changed) == len(rest), "the first frame brings all"
    for before, after in zip(sparse, sparse[1:]):
        assert after.changed is not None and 0 < len(after.changed) < len(rest)
        untouched = np.setdiff1d(np.arange(len(rest)), after.changed)
        assert np.array_equal(before.positions[untouched], after.positions[untouched])


@pytest.mark.parametrize("encoding", ["meshopt", "delta"])
def test_packed_frames_show_what_whole_ones_show(held: pliant.Session, encoding: Literal["meshopt", "delta"]) -> None:
    whole = list(held.drag(POSES, normals=True, tolerance=1e-9))
    packed = list(held.drag(POSES, normals=True, tolerance=1e-9, encoding=encoding))
    assert len(packed) == len(POSES)
    for frame, exact in zip(packed, whole):
        # The box of a frame from which others are told has an eighth of room on each side, and may be as old as the drag.
        step = np.ptp(exact.positions, axis=0).max() * 1.5 / 65535
        assert 0 < np.abs(frame.positions - exact.positions).max() <= step
        assert frame.normals is not None and exact.normals is not None
        assert np.abs(frame.normals - exact.normals).max() <= 2 / 65535
    packed[0].positions[:] = 7  # the caller may write to it
    solved = held.solve(POSES[-1], encoding=encoding)
    assert np.abs(solved - held.positions()).max() <= np.ptp(solved, axis=0).max() * 1.5 / 65535


def test_changes_and_differences_are_not_asked_for_together(held: pliant.Session) -> None:
    with pytest.raises(pliant.InvalidArgument, match="next to nothing"):
        list(held.drag(POSES, changed_only=0.0, encoding="delta"))


def test_progressive_frames_get_better(held: pliant.Session) -> None:
    frames = list(held.drag(POSES[-1:], progressive=True, tolerance=1e-10))
    assert [f.seq for f in frames] == [1] * len(frames) and frames[-1].final
    assert not any(f.final for f in frames[:-1])
    assert frames[-1].residual <= 1e-10


def test_a_stream_takes_poses_without_waiting_and_keeps_handles_that_are_not_named(held: pliant.Session) -> None:
    held.handle("tail", sphere=((-1.0, 1.06, 0), 0.16))
    with held.stream() as stream:
        assert stream.latest() is None
        with pytest.raises(pliant.FailedPrecondition, match="no pose"):
            stream.wait()
        stream.send({"head": {"rotation_vector": (0, 0.8, 0)}})
        turned = stream.wait(timeout=30)
        stream.send({"tail": {"translation": (0, 0.1, 0)}})
        both = stream.wait(timeout=30)
        rest = held.positions()
        assert np.allclose(head(both.positions, rest), head(turned.positions, rest), atol=1e-6)
        with pytest.raises(pliant.DeadlineExceeded, match="0.05 s"):
            stream.receive(timeout=0.05)
        committed = stream.commit({"tail": {"translation": (0, 0.2, 0)}})
        assert committed.quality is not None
        assert np.allclose(head(committed.positions, rest), head(turned.positions, rest), atol=1e-6)
        # After a commit the stream goes on from there.
        stream.send({"head": {"rotation_vector": (0, 0.4, 0)}})
        on = stream.wait(timeout=30)
        tail = np.linalg.norm(rest - [-1.0, 1.06, 0], axis=1) < 0.16
        assert np.allclose(on.positions[tail], committed.positions[tail], atol=1e-6)
    with pytest.raises(pliant.FailedPrecondition, match="closed"):
        stream.send({})
    stream.close()


def test_a_refused_pose_is_told_and_the_stream_goes_on(held: pliant.Session) -> None:
    with held.stream() as stream:
        refused = stream.send({"wing": {}})
        with pytest.raises(pliant.InvalidArgument, match='"wing"') as caught:
            stream.wait(timeout=30)
        assert caught.value.seq == refused
        with pytest.raises(pliant.InvalidArgument):
            stream.send({"head": {"rotation": (1, 0, 0, 5)}})
            stream.wait(timeout=30)
        stream.send({"head": {}})
        assert stream.wait(timeout=30).final
        assert stream.commit().final, "what was refused does not come back with a commit"


def test_a_reader_that_polls_gets_the_newest_frame_and_never_stalls(held: pliant.Session) -> None:
    with held.stream(window=2) as stream:
        stop = threading.Event()

        def sender() -> None:
            for k in range(100):
                stream.send({"head": {"rotation_vector": (0, 0.005 * k, 0)}})
                time.sleep(0.002)
            stop.set()

        threading.Thread(target=sender).start()
        newest = None
        end = time.monotonic() + 60
        while newest is None or newest.seq < 100:
            assert time.monotonic() < end, f"stuck at {newest and newest.seq}"
            newest = stream.latest() or newest
            time.sleep(0.001)
        assert newest.final


def test_frames_with_contact_avoid_hardly_cross(server: pliant.LocalServer, tmp_path: Path) -> None:
    body = tmp_path / "body.glb"
    subprocess.run([find_binary(), "sample", "body", "-o", body], check=True, capture_output=True)
    poses = [{"forearm": {"rotation_vector": (0, -2.53 * k / 30, 0)}} for k in range(1, 31)]

    def crossing(positions: np.ndarray, faces: np.ndarray) -> int:
        with pliant.open((positions, faces), server=server) as shape:
            return len(shape.crossings().at_rest)

    def crossing_on_a_drag(contact: Literal["ignore", "avoid"]) -> list[int]:
        with pliant.open(body, server=server) as session:
            session.handle("body", half_space=((-1, 0, 0), -0.3))
            session.handle("forearm", half_space=((1, 0, 0), 0.65))
            frames = list(session.drag(poses, contact=contact))
            return [crossing(frame.positions, session.triangles()) for frame in frames[-6:]]

    plain, parted = crossing_on_a_drag("ignore"), crossing_on_a_drag("avoid")
    assert plain[-1] > 100, "the forearm passes through the arm"
    assert sum(parted) <= 0.05 * sum(plain), f"{parted} of {plain}"
