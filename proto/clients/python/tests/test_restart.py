"""A server that is restarted under its clients, politely and not: drags go on, and every commit is recorded once."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import pliant
import pliant.aio
from conftest import binary
from pliant import errors
from pliant.channel import Attempts

TURN = {"head": {"rotation_vector": (0, 0.8, 0)}}
POSES = [{"head": {"rotation_vector": (0, 0.8 * k / 30, 0)}} for k in range(1, 31)]
# Far more than it takes; a server that had to wait for its clients would need all of it.
DRAIN = "300s"


class Kept:
    """A server that keeps its sessions, on a port of its own, which it has again after a restart."""

    def __init__(self, folder: Path) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self._port = free.getsockname()[1]
        self.url = f"http://127.0.0.1:{self._port}"
        self._folder = folder
        self._start()

    def _start(self) -> None:
        flags = [f"--listen=127.0.0.1:{self._port}", f"--data-dir={self._folder}", f"--drain-deadline={DRAIN}", "--log=warn"]
        self._process = subprocess.Popen([binary(), "serve", *flags], stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        assert self._process.stdout.readline().startswith("listening on ")

    def restart(self, how: signal.Signals, pause: float = 0.0) -> None:
        """Ends it by a signal and starts it again, after a pause."""
        self._process.send_signal(how)
        code = self._process.wait(timeout=60)
        assert code == (0 if how == signal.SIGTERM else -how), "it ended well, and not because its time was over"
        time.sleep(pause)
        self._start()

    def end(self) -> None:
        self._process.kill()
        self._process.wait()


@pytest.fixture
def kept(tmp_path: Path) -> Iterator[Kept]:
    if os.name != "posix":
        pytest.skip("needs signals")
    server = Kept(tmp_path / "data")
    yield server
    server.end()


def hold(session: object) -> None:
    session.handle("feet", half_space=((0, -1, 0), -0.14))  # type: ignore[attr-defined]
    session.handle("head", sphere=((0.76, 1.22, 0), 0.36))  # type: ignore[attr-defined]


def aside(work: Callable[[], None]) -> threading.Thread:
    """Runs something on a thread, and a failure of it in whoever joins."""
    failure: list[BaseException] = []

    def run() -> None:
        try:
            work()
        except BaseException as error:
            failure.append(error)

    class Told(threading.Thread):
        def join(self, timeout: float | None = None) -> None:
            super().join(timeout)
            if failure:
                raise failure[0]

    thread = Told(target=run)
    thread.start()
    return thread


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_a_drag_goes_on_while_its_server_is_restarted(kept: Kept, creature: Path, how: signal.Signals) -> None:
    with pliant.open(creature, server=kept.url, way={"patience": 60}) as session:
        hold(session)
        session.solve(TURN)
        restarts = []
        seen = []
        for frame in session.drag(POSES, tolerance=1e-9, commit="last"):
            seen.append(frame.seq)
            if len(seen) in (5, 15):
                restarts.append(aside(lambda: kept.restart(how)))
            if len(seen) == 6 or len(seen) == 16:
                restarts[-1].join()
        assert seen[:-1] == list(range(1, 30)), "every pose was answered once, in order"
        assert [c.kind for c in session.history()] == ["create", "handles", "pose", "pose"]
        assert np.array_equal(session.positions(), frame.positions), "the last pose is recorded"
        assert np.array_equal(session.solve(POSES[-1], tolerance=1e-9), frame.positions), "to the bit"


def test_commits_made_during_restarts_are_recorded_once(kept: Kept, creature: Path) -> None:
    with pliant.open(creature, server=kept.url, way={"patience": 60}) as session:
        hold(session)
        session.apply()
        done = threading.Event()

        def restarts() -> None:
            for how in (signal.SIGKILL, signal.SIGTERM, signal.SIGKILL):
                time.sleep(0.2)
                kept.restart(how)
            done.set()

        restarting = aside(restarts)
        made = []
        with session.stream() as stream:
            while not done.is_set() or len(made) < 10:
                angle = 0.01 * (len(made) + 1)
                stream.send({"head": {"rotation_vector": (0, angle, 0)}})
                made.append(stream.commit())
                if not restarting.is_alive():
                    restarting.join()
        restarting.join()
        poses = [c for c in session.history() if c.kind == "pose"]
        assert [c.revision for c in poses] == [frame.revision for frame in made]
        assert np.array_equal(session.positions(), made[-1].positions)


def test_a_stream_without_poses_comes_back_and_lets_its_server_go(kept: Kept, creature: Path) -> None:
    with pliant.open(creature, server=kept.url, way={"patience": 60}) as session:
        hold(session)
        with session.stream() as stream:
            stream.send(TURN)
            turned = stream.wait(timeout=30).positions
            kept.restart(signal.SIGTERM)
            end = time.monotonic() + 30
            while stream.reconnects == 0 or stream.lost:
                assert time.monotonic() < end
                time.sleep(0.01)
            stream.send({"head": {"rotation_vector": (0, 0.8, 0)}})
            assert np.allclose(stream.wait(timeout=30).positions, turned, atol=1e-3)


def test_asyncio_goes_on_too(kept: Kept, creature: Path) -> None:
    async def work() -> None:
        async with pliant.aio.open(creature, server=kept.url, way={"patience": 60}) as session:
            hold(session)
            seen = []
            async with await session.stream(tolerance=1e-9) as stream:
                for k, pose in enumerate(POSES):
                    stream.send(pose)
                    if k in (5, 15):
                        how = signal.SIGTERM if k == 5 else signal.SIGKILL
                        await asyncio.to_thread(kept.restart, how)
                    frame = await stream.wait()
                    seen.append(frame.seq)
                assert stream.reconnects >= 2 and not stream.lost
                recorded = await stream.commit()
            assert seen == list(range(1, 31))
            assert [c.kind for c in await session.history()] == ["create", "handles", "pose"]
            assert np.array_equal(await session.positions(), recorded.positions)

    asyncio.run(work())


def test_a_server_that_does_not_come_back_is_told_with_how_long_it_was_looked_for(creature: Path, tmp_path: Path) -> None:
    server = Kept(tmp_path / "data")
    session = pliant.open(creature, server=server.url, way={"patience": 0.5})
    hold(session)
    with session.stream() as stream:
        stream.send(TURN)
        stream.wait(timeout=30)
        server.end()
        with pytest.raises(pliant.Unavailable, match=r"tried again for 0\.5 s"):
            session.solve(TURN)
        with pytest.raises(pliant.Unavailable, match=r"tried again for 0\.5 s"):
            stream.wait(timeout=30)


def test_pauses_grow_and_heed_the_server() -> None:
    gone, busy = errors.Unavailable("gone"), errors.ResourceExhausted("full", retry_after=0.1)
    attempts = Attempts(60)
    assert attempts.left == 60, "waiting for an answer is not a failure"
    pauses = [attempts.again(gone) or 0 for _ in range(12)]
    assert 0 < pauses[0] <= 0.05 and all(0.5 <= pause <= 1 for pause in pauses[6:])
    assert (attempts.again(errors.Unavailable("later", retry_after=7)) or 0) >= 7
    assert attempts.again(errors.Unavailable("much later", retry_after=600)) is None
    assert attempts.again(errors.InvalidArgument("wrong")) is None
    assert attempts.again(busy) is None, "who comes first is told that there is no room"
    assert (Attempts(60, resuming=True).again(busy) or 0) >= 0.1, "who comes back waits for the own place"
    assert Attempts(0).again(gone) is None
