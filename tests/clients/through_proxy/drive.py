"""Drags and commits sessions through a proxy until stdin ends, with the Python client as it is: half on threads, half on an event loop.

    drive.py URL MODEL SESSIONS

Says `ready` when all sessions are open, and at the end one line of JSON: what was acknowledged of each session, and how long its
stream was away. Nothing is caught here: whatever the client does not get over by itself ends this program.
"""

from __future__ import annotations

import asyncio
import json
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pliant
import pliant.aio

COMMIT_EVERY = 4
PAUSE = 0.12
# The database is away for longer than the default.
PATIENCE = 60

stop = threading.Event()


def hold(session: Any) -> None:
    session.handle("base", half_space=((0, 0, -1), -0.25))
    session.handle("top", half_space=((0, 0, 1), 3.75))


def turned(angle: float) -> dict[str, Any]:
    return {"top": {"rotation_vector": (0, 0, angle), "translation": (0, 0, 0.25)}}


class Told:
    """What came back of one session."""

    def __init__(self, session: str) -> None:
        self.session = session
        self.commits: list[tuple[float, int]] = []
        self.answers = 0
        self.away = 0.0

    def answered(self, asked: float) -> None:
        self.away, self.answers = max(self.away, time.monotonic() - asked), self.answers + 1

    @property
    def next_angle(self) -> float:
        return 0.02 * (len(self.commits) * 7 % 40) - 0.4

    def line(self, reconnects: int) -> dict[str, Any]:
        return {
            "id": self.session,
            "commits": self.commits,
            "answers": self.answers,
            "away": self.away,
            "reconnects": reconnects,
        }


def drive(session: pliant.Session) -> dict[str, Any]:
    told = Told(session.id)
    with session.stream() as stream:
        while not stop.is_set():
            asked = time.monotonic()
            stream.send(turned(0.01 * (told.answers % 50)))
            stream.wait()
            told.answered(asked)
            if told.answers % COMMIT_EVERY == 0:
                angle = told.next_angle
                told.commits.append((angle, stream.commit(turned(angle)).revision))
            time.sleep(PAUSE)
        return told.line(stream.reconnects)


async def drive_on_loop(session: pliant.aio.Session) -> dict[str, Any]:
    told = Told(session.id)
    async with await session.stream() as stream:
        while not stop.is_set():
            asked = time.monotonic()
            stream.send(turned(0.01 * (told.answers % 50)))
            await stream.wait()
            told.answered(asked)
            if told.answers % COMMIT_EVERY == 0:
                angle = told.next_angle
                told.commits.append((angle, (await stream.commit(turned(angle))).revision))
            await asyncio.sleep(PAUSE)
        return told.line(stream.reconnects)


async def on_loop(url: str, model: bytes, count: int, ready: threading.Barrier) -> list[dict[str, Any]]:
    async with await pliant.aio.connect(url, patience=PATIENCE) as client:
        sessions = [await client.open(model, format="obj", keep=True) for _ in range(count)]
        for session in sessions:
            hold(session)
            await session.apply()
        await asyncio.to_thread(ready.wait)
        return await asyncio.gather(*map(drive_on_loop, sessions))


def main() -> None:
    url, model, count = sys.argv[1], Path(sys.argv[2]).read_bytes(), int(sys.argv[3])
    threads = (count + 1) // 2
    ready = threading.Barrier(2)
    lines: list[dict[str, Any]] = []
    failures: list[BaseException] = []

    def run(work: Any, *arguments: Any) -> threading.Thread:
        def guarded() -> None:
            try:
                done = work(*arguments)
                lines.extend(done if isinstance(done, list) else [done])
            except BaseException as failure:
                failures.append(failure)
                raise

        thread = threading.Thread(target=guarded)
        thread.start()
        return thread

    with pliant.connect(url, patience=PATIENCE) as client:
        running = [run(lambda: asyncio.run(on_loop(url, model, count - threads, ready)))]
        sessions = [client.open(model, format="obj", keep=True) for _ in range(threads)]
        for session in sessions:
            hold(session)
            session.apply()
        ready.wait(120)
        running += [run(drive, session) for session in sessions]
        print("ready", flush=True)
        sys.stdin.read()
        stop.set()
        for thread in running:
            thread.join()
    if failures:
        sys.exit(1)
    print(json.dumps(lines), flush=True)


main()
