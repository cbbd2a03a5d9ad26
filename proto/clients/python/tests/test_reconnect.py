"""Lost connections and lost servers: what is resumed, what is told, and that nothing is committed twice."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import grpc
import numpy as np
import pytest

import pliant
from conftest import Proxy, binary
from pliant.frames import Assembler, Frame
from pliant.options import SolveFields
from pliant.transport import Blocking, run
from pliant.v1 import pliant_pb2 as pb

TURN = {"head": {"rotation_vector": (0, 0.8, 0)}}


def hold(session: pliant.Session) -> None:
    session.handle("feet", half_space=((0, -1, 0), -0.14))
    session.handle("head", sphere=((0.76, 1.22, 0), 0.36))


@pytest.fixture
def held(proxy: Proxy, creature: Path) -> Iterator[pliant.Session]:
    with pliant.open(creature, server=proxy.url) as session:
        hold(session)
        session.apply()
        yield session


def test_calls_find_their_way_back(held: pliant.Session, proxy: Proxy) -> None:
    before = held.solve(TURN)
    proxy.drop()
    assert np.array_equal(held.positions(), before)
    proxy.drop()
    held.undo()
    proxy.drop()
    assert np.array_equal(held.solve(TURN), before)
    assert [c.kind for c in held.history()] == ["create", "handles", "pose"]
    assert proxy.connections >= 3


def test_a_call_waits_while_the_way_is_closed(held: pliant.Session, proxy: Proxy) -> None:
    proxy.shut()
    threading.Timer(0.7, lambda: proxy.shut(False)).start()
    assert held.solve(TURN).shape == (held.vertices, 3)


def test_a_commit_whose_answer_was_lost_is_recorded_once(held: pliant.Session, proxy: Proxy) -> None:
    for k in range(8):
        cutter = threading.Timer(0.004 * k, proxy.drop)
        cutter.start()
        held.solve({"head": {"rotation_vector": (0, 0.1 * (k + 1), 0)}})
        cutter.join()
    assert [c.kind for c in held.history()] == ["create", "handles"] + ["pose"] * 8


@pytest.mark.parametrize(("how", "off"), [({"changed_only": 1e-6}, 1e-4), ({"encoding": "delta"}, 2e-4)])
def test_a_drag_goes_on_after_the_connection_was_cut(
    held: pliant.Session, proxy: Proxy, how: SolveFields, off: float
) -> None:
    poses = [{"head": {"rotation_vector": (0, 0.8 * k / 20, 0)}} for k in range(1, 21)]
    seen = []
    for frame in held.drag(poses, tolerance=1e-9, **how):
        seen.append(frame.seq)
        if frame.seq in (5, 12):
            proxy.drop()
    assert seen == list(range(1, 21)), "every pose was answered once, in order"
    straight = held.solve(poses[-1], tolerance=1e-9, refine=0)
    assert np.allclose(frame.positions, straight, atol=off)


def test_a_stream_says_where_handles_are_after_it_was_opened_anew(held: pliant.Session, proxy: Proxy) -> None:
    held.handle("tail", sphere=((-1.0, 1.06, 0), 0.16))
    with held.stream(tolerance=1e-9) as stream:
        stream.send(TURN)
        turned = stream.wait(timeout=30).positions
        proxy.drop()
        deadline = time.monotonic() + 30
        while stream.reconnects == 0:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        # Only the tail is named; the head stays turned although the new connection never heard of it.
        stream.send({"tail": {"translation": (0, 0.1, 0)}})
        both = stream.wait(timeout=30).positions
        rest = held.positions()
        head = np.linalg.norm(rest - [0.76, 1.22, 0], axis=1) < 0.36
        assert np.allclose(both[head], turned[head], atol=1e-6)


def unreadable(monkeypatch: pytest.MonkeyPatch, faults: Iterator[Exception | None]) -> None:
    """Lets the next parts that come have these faults."""
    take = Assembler.take

    def faulty(self: Assembler, part: pb.Frame) -> Frame | None:
        fault = next(faults, None)
        if fault is not None:
            raise fault
        return take(self, part)

    monkeypatch.setattr(Assembler, "take", faulty)


def test_a_frame_that_cannot_be_read_is_asked_for_once_more(
    held: pliant.Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    for faults in (1, 2):
        with held.stream() as stream:
            unreadable(monkeypatch, iter([pliant.Internal("no code")] * faults))
            stream.send(TURN)
            if faults == 1:
                assert stream.wait(timeout=30).seq == 1
            else:
                with pytest.raises(pliant.Internal, match="no code$"):
                    stream.wait(timeout=30)
            assert stream.reconnects == 1
    monkeypatch.undo()


def test_a_defect_of_this_package_ends_a_stream_and_nobody_waits_for_ever(
    held: pliant.Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    with held.stream() as stream:
        unreadable(monkeypatch, iter([KeyError("what nobody thought of")]))
        stream.send(TURN)
        with pytest.raises(pliant.Internal, match="KeyError.*nobody thought of"):
            stream.wait(timeout=30)
    monkeypatch.undo()


def test_a_server_that_stands_still_is_left_by_calls_and_streams(held: pliant.Session, proxy: Proxy) -> None:
    with held.stream() as stream:
        stream.send(TURN)
        stream.wait(timeout=30)
        proxy.freeze()
        # Nothing is closed and nothing is refused: only signs of life that do not come tell it.
        stream.send({"head": {"rotation_vector": (0, 0.5, 0)}})
        assert stream.wait(timeout=45).seq == 2
        assert stream.reconnects > 0
        proxy.freeze()
        before = proxy.connections
        assert held.solve(TURN).shape == (held.vertices, 3)
        assert proxy.connections > before
    assert [c.kind for c in held.history()] == ["create", "handles", "pose"]


def test_patience_ends(creature: Path, proxy: Proxy) -> None:
    session = pliant.open(creature, server=proxy.url, way={"patience": 0.4})
    hold(session)
    session.apply()
    stream = session.stream()
    proxy.shut()
    with pytest.raises(pliant.Unavailable):
        session.solve(TURN)
    with pytest.raises(pliant.Unavailable):
        while True:
            stream.latest()
            time.sleep(0.01)
    with pytest.raises(ConnectionError):
        session.positions()
    stream.close()
    session.close()


def test_nobody_there_is_said_with_the_address() -> None:
    with pytest.raises(pliant.Unavailable, match="127.0.0.1:9"):
        pliant.connect("http://127.0.0.1:9", patience=0).limits()


def test_a_session_does_not_survive_its_server_and_says_so(creature: Path) -> None:
    first = pliant.LocalServer(binary())
    way = Proxy(first.url)
    try:
        session = pliant.open(creature, server=way.url)
        hold(session)
        stream = session.stream()
        stream.send(TURN)
        stream.wait(timeout=30)
        first.kill()
        with pliant.LocalServer(binary()) as second:
            host, port = second.url.removeprefix("http://").split(":")
            way._target = (host, int(port))
            with pytest.raises(pliant.SessionLost, match="open the model again|Open the model again"):
                session.solve(TURN)
            with pytest.raises(pliant.SessionLost, match=session.id):
                stream.send(TURN)
                stream.wait(timeout=30)
            with pytest.raises(pliant.SessionLost):
                session.positions()
            session.close()
            with pliant.open(creature, server=way.url) as again:
                hold(again)
                assert again.solve(TURN).shape == (again.vertices, 3)
    finally:
        way.close()
        first.stop()


def test_a_server_of_ones_own_that_dies_is_named(creature: Path) -> None:
    with pliant.LocalServer(binary()) as server:
        session = pliant.open(creature, server=server)
        hold(session)
        with session.stream() as stream:
            server.kill()
            start = time.monotonic()
            with pytest.raises(pliant.LocalServerError, match="ended with code"):
                session.solve(TURN)
            with pytest.raises(pliant.LocalServerError, match="ended with code"):
                stream.send(TURN)
                stream.wait(timeout=30)
            assert time.monotonic() - start < 10, "there is nothing to wait for"
        session.close()


@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_connection_that_is_closed_while_it_is_waited_for_leaves_no_trace() -> None:
    waiting = []
    for k in range(6):
        # No server listens there.
        line = grpc.insecure_channel("127.0.0.1:1")
        wait = Blocking().ready(line, time.monotonic() + 1.2, lambda: False)
        waiting.append(threading.Thread(target=run, args=(wait,)))
        waiting[-1].start()
        threading.Timer(0.42 + 0.05 * k, line.close).start()
    for thread in waiting:
        thread.join()
