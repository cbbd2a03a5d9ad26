"""The asyncio half: the same calls, many at a time, cancelled, cut off, and equal to the synchronous half."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Coroutine
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pliant
import pliant.aio
from conftest import Proxy, binary
from pliant.frames import Assembler
from pliant.transport import OnLoop
from pliant.v1 import pliant_pb2 as pb

POSES = [{"head": {"rotation_vector": (0, 0.8 * k / 12, 0)}} for k in range(1, 13)]
TURN = POSES[-1]


def run(work: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(work, 120))


def hold(session: pliant.Session | pliant.aio.Session) -> None:
    session.handle("feet", half_space=((0, -1, 0), -0.14))
    session.handle("head", sphere=((0.76, 1.22, 0), 0.36))


def test_a_session_from_first_to_last(server: pliant.LocalServer, creature: Path, tmp_path: Path) -> None:
    async def work() -> None:
        async with pliant.aio.open(creature, server=server) as s:
            hold(s)
            rest = await s.positions()
            bent = await s.solve(TURN)
            assert np.array_equal(await s.positions(), bent)
            await s.undo()
            assert np.array_equal(await s.positions(), rest)
            await s.redo()
            assert [c.kind for c in await s.history()] == ["create", "handles", "pose"]
            [written] = await s.export(tmp_path / "out.obj")
            assert written.read_bytes().count(b"\nv ") > 1000
            assert (await s.refresh()).revision == s.info.revision
            with pytest.raises(pliant.InvalidArgument, match='"hed"'):
                await s.solve({"hed": {}})
            with pytest.raises(pliant.PliantError) as refused:
                await s.edit(delete={"region": {"sphere": ((500, 0, 0), 1)}})
            assert refused.value.code in ("UNIMPLEMENTED", "INVALID_ARGUMENT")
        with pliant.open(creature, server=server) as same:
            hold(same)
            assert np.array_equal(same.solve(TURN), bent), "both halves give the same bits"

    run(work())


def test_what_is_there_needs_no_time() -> None:
    async def work() -> None:
        transport = OnLoop()
        news = transport.news()
        assert await transport.wait_for(news, lambda: True, 0)
        assert not await transport.wait_for(news, lambda: False, 0)

    run(work())


def test_drags_of_every_kind(server: pliant.LocalServer, creature: Path) -> None:
    async def mouse() -> AsyncIterator[pliant.poses.Poses]:
        for pose in POSES:
            await asyncio.sleep(0.001)
            yield pose

    async def work() -> None:
        async with await pliant.aio.connect(server) as client, await client.open(creature) as s:
            hold(s)
            assert [f.seq async for f in s.drag(POSES)] == list(range(1, 13))
            frames = [f async for f in s.drag(mouse(), latest=True)]
            assert frames[-1].seq == 12 and len(frames) + sum(f.superseded for f in frames) == 12
            last = [f async for f in s.drag(mouse(), commit="last")][-1]
            assert last.quality is not None and np.array_equal(last.positions, await s.positions())
            assert len([f async for f in s.drag(POSES[:2], commit=True)]) == 2
            told: list[int] = []
            assert [f async for f in s.drag(POSES[:2], changed_only=1e-6, progress=lambda d, t: told.append(d))]
            assert told == [1, 2]

    run(work())


def test_sessions_run_side_by_side(server: pliant.LocalServer, creature: Path) -> None:
    async def one(angle: float) -> np.ndarray:
        async with pliant.aio.open(creature, server=server) as s:
            hold(s)
            return await s.solve({"head": {"rotation_vector": (0, angle, 0)}})

    async def work() -> None:
        together = await asyncio.gather(*(one(0.1 * k) for k in range(6)))
        assert np.array_equal(together[3], await one(0.1 * 3))

    run(work())


def test_a_stream_polls_waits_commits_and_is_cancelled(server: pliant.LocalServer, creature: Path) -> None:
    async def work() -> None:
        async with pliant.aio.open(creature, server=server) as s:
            hold(s)
            async with await s.stream() as stream:
                assert stream.latest() is None
                with pytest.raises(TimeoutError):
                    await asyncio.wait_for(stream.receive(), 0.05)
                with pytest.raises(pliant.DeadlineExceeded):
                    await stream.receive(timeout=0.05)
                stream.send(TURN)
                frame = await stream.wait()
                assert frame.final
                stream.send(TURN)
                while not stream._frames:
                    await asyncio.sleep(0.01)
                assert (await stream.receive(timeout=0)).seq == 2, "a frame that is there needs no time"
                stream.send({"wing": {}})
                with pytest.raises(pliant.InvalidArgument, match="wing"):
                    await stream.wait()
                committed = await stream.commit()
                assert np.allclose(committed.positions, await s.positions())
            with pytest.raises(pliant.FailedPrecondition, match="closed"):
                stream.send(TURN)
            solving = asyncio.create_task(s.solve(TURN, tolerance=1e-12, refine=20))
            await asyncio.sleep(0.01)
            solving.cancel()
            with pytest.raises(asyncio.CancelledError):
                await solving
            await s.solve(TURN)

    run(work())


def test_a_lost_connection_is_found_again(proxy: Proxy, creature: Path) -> None:
    async def work() -> None:
        async with pliant.aio.open(creature, server=proxy.url) as s:
            hold(s)
            before = await s.solve(TURN)
            proxy.drop()
            assert np.array_equal(await s.solve(TURN), before)
            seen = []
            async for frame in s.drag(POSES):
                seen.append(frame.seq)
                if frame.seq == 5:
                    proxy.drop()
            assert seen == list(range(1, 13))
            proxy.shut()
            asyncio.get_running_loop().call_later(0.7, proxy.shut, False)
            assert np.array_equal(await s.solve(TURN), before)

    run(work())


def test_a_server_that_restarted_has_lost_the_session(creature: Path) -> None:
    async def work() -> None:
        with pliant.LocalServer(binary()) as server:
            s = await pliant.aio.open(creature, server=server)
            hold(s)
            stream = await s.stream()
            server.kill()
            with pytest.raises(pliant.LocalServerError, match="ended with code"):
                await s.solve(TURN)
            with pytest.raises(pliant.LocalServerError):
                stream.send(TURN)
                await stream.wait()
            await stream.close()
            await s.close()

    run(work())


def test_limits_and_lists(server: pliant.LocalServer, creature: Path) -> None:
    async def work() -> None:
        async with await pliant.aio.connect(server) as client:
            assert (await client.limits()).sessions > 0
            assert (await client.sample("figure"))[:4] == b"glTF"
            s = await client.open(creature, keep=True, ttl="1m")
            await s.close()
            assert s.id in [listed.id async for listed in client.sessions()]
            await (await client.attach(s.id, keep=False)).close()
            with pytest.raises(pliant.NotFound):
                await client.attach(s.id)
            gone = await client.open(creature)
            await gone.close()
            for call in (gone.refresh, gone.positions, gone.stream):
                with pytest.raises(pliant.SessionLost, match=r"was closed by close\(\)"):
                    await call()
            left = await client.open(creature)
            with pytest.raises(ValueError, match="commit: 'first'"):
                _ = [f async for f in left.drag([TURN], commit="first")]  # type: ignore[arg-type]
        for call in (client.limits, left.refresh, left.positions, (await left.stream()).receive):
            with pytest.raises(pliant.FailedPrecondition, match="the connection is closed"):
                await call()
        await left.close()

    run(work())


@pytest.mark.parametrize("fault", [pliant.Internal("no code"), KeyError("what nobody thought of")])
def test_frames_that_cannot_be_read_end_a_stream_and_nobody_waits_for_ever(
    server: pliant.LocalServer, creature: Path, monkeypatch: pytest.MonkeyPatch, fault: Exception
) -> None:
    def faulty(self: Assembler, part: pb.Frame) -> None:
        raise fault

    async def work() -> None:
        async with pliant.aio.open(creature, server=server) as s:
            hold(s)
            async with await s.stream() as stream:
                monkeypatch.setattr(Assembler, "take", faulty)
                stream.send(TURN)
                with pytest.raises(pliant.Internal, match=str(fault)):
                    await asyncio.wait_for(stream.wait(), 30)
                assert stream.reconnects == isinstance(fault, pliant.Internal)

    run(work())
