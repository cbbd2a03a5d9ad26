"""Animations: frames as arrays, the same as on the command line, whole after a cut, stopped when nobody wants them."""

from __future__ import annotations

import asyncio
import json
import subprocess
import time
import urllib.request
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import pliant
import pliant.aio
from conftest import Proxy, bar, binary

CLIP = """HIERARCHY
ROOT low
{
OFFSET 0 0 0
CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
JOINT high
{
OFFSET 0 0 2
CHANNELS 3 Zrotation Xrotation Yrotation
End Site
{
OFFSET 0 0 2
}
}
}
MOTION
Frames: FRAMES
Frame Time: 0.05
"""

RIG = {
    "version": 1,
    "joints": {"bottom": [0, 0, 0.1], "middle": [0, 0, 2], "top": (0, 0, 3.9)},
    "bones": [
        {"id": "low", "from": "bottom", "to": "middle", "joint": "low", "rest": "ORIENTATION", "radius": 0.3},
        {
            "id": "high",
            "from": "middle",
            "to": "top",
            "parent": "low",
            "joint": "high",
            "rest": "ORIENTATION",
            "radius": 0.3,
        },
    ],
}


def clip(frames: int) -> bytes:
    rows = [f"{0.01 * k} 0 0 {0.5 * k} 0 0 0 {40 * np.sin(0.2 * k)} 0" for k in range(frames)]
    return (CLIP.replace("FRAMES", str(frames)) + "\n".join(rows) + "\n").encode()


def test_frames_are_those_of_the_command_line(server: pliant.LocalServer, figure: Path, tmp_path: Path) -> None:
    command = [binary(), "animate", str(figure), "--clip", "walk", "--frames", "0:9", "--json"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    wanted = [frame["digest"] for frame in json.loads(done.stdout)["frames"]]
    # The hull has no skin, and two meshes are coarser levels of detail, so the command does not solve them.
    with pliant.open(figure, server=server, passengers=[1, 2, 3]) as session:
        told: list[tuple[int, int]] = []
        walk = session.animate("walk", count=9, normals=True, progress=lambda *counts: told.append(counts))
        frames = list(walk)
        assert [frame.index for frame in frames] == list(range(9)) and told[-1] == (9, 9)
        first = frames[0]
        assert first.positions.shape == (session.vertices, 3) and first.positions.dtype == np.float32
        assert first.normals is not None and np.allclose(np.linalg.norm(first.normals, axis=1), 1, atol=1e-3)
        assert walk.report is not None and walk.report.totals.frames == 9
        digests = [frame.digest for frame in frames]
        assert digests == wanted and not any("no skin" in warning for warning in walk.report.warnings)
        assert [c.kind for c in session.history()] == ["create"]
        again = [frame.digest for frame in session.animate(0, first=5, count=4)]
        assert again == digests[5:]
    with pliant.open(figure, server=server) as session:
        walk = session.animate(count=1)
        assert len(list(walk)) == 1 and walk.report is not None
        assert any('"hull" has no skin, and is solved' in warning for warning in walk.report.warnings)


def test_a_recording_drives_a_rig(server: pliant.LocalServer, tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(RIG))
    with pliant.open(bar(), server=server) as session:
        how = {"skip_first": False}
        frames = list(session.animate(bvh=clip(12), rig=RIG, **how))
        baked = list(session.animate(bvh=clip(12), rig=path, root="baked", **how))
        assert len(frames) == len(baked) == 12
        for frame, moved in zip(frames, baked):
            assert np.allclose(frame.placed(), moved.positions, atol=1e-5) and frame.digest == moved.digest
            assert np.array_equal(moved.root_translation, np.zeros(3))
        assert not np.allclose(frames[-1].placed(), frames[-1].positions, atol=1e-2)
        # Too large for one message.
        (tmp_path / "long.bvh").write_bytes(clip(12) + b"\n" * (5 << 20))
        long = session.animate(bvh=tmp_path / "long.bvh", rig=RIG, **how)
        assert [frame.digest for frame in long] == [frame.digest for frame in frames]


def test_frames_with_contact_avoid_do_not_cross(server: pliant.LocalServer, tmp_path: Path) -> None:
    for name in ("body.glb", "boxing.bvh"):
        subprocess.run([binary(), "sample", Path(name).stem, "-o", tmp_path / name], check=True, capture_output=True)
    with pliant.open(tmp_path / "body.glb", server=server) as session:
        plain = list(session.animate(bvh=tmp_path / "boxing.bvh", count=16))
        walk = session.animate(bvh=tmp_path / "boxing.bvh", count=16, contact="avoid")
        parted = list(walk)
        assert walk.report is not None
        totals = walk.report.totals
        assert totals.HasField("crossing_frames") and totals.crossing_frames == 0
        assert totals.new_self_intersections_worst == 0 and not totals.HasField("worst_crossing_frame")
        same = [a.digest == b.digest for a, b in zip(plain, parted, strict=True)]
        assert any(same) and not all(same), "frames that do not cross keep their bits, and others cross"
        with pytest.raises(ValueError, match="contact"):
            list(session.animate(bvh=tmp_path / "boxing.bvh", contact="touch"))  # type: ignore[arg-type]


def test_what_is_wrong_is_said(server: pliant.LocalServer) -> None:
    with pliant.open(bar(), server=server) as session:
        with pytest.raises(pliant.InvalidArgument, match="line 1: a BVH file begins with HIERARCHY") as refused:
            list(session.animate(bvh=b"no clip", rig=RIG))
        assert refused.value.field == "clip"
        with pytest.raises(pliant.InvalidArgument, match="no clips of its own"):
            list(session.animate())
        for wrong, told in [({"speed": 2}, "speed"), ({"root": "up"}, "root"), ({"count": 0.5}, "count")]:
            with pytest.raises((TypeError, ValueError), match=told):
                session.animate(bvh=clip(3), rig=RIG, **wrong)
        with pytest.raises(ValueError, match="rig"):
            session.animate(bvh=clip(3), rig={"bons": []})


def test_a_lost_connection_loses_no_frame(proxy: Proxy) -> None:
    with pliant.open(bar(), server=proxy.url) as session:
        wanted = [frame.digest for frame in session.animate(bvh=clip(80), rig=RIG)]
        playing = session.animate(bvh=clip(80), rig=RIG)
        seen = []
        for frame in playing:
            seen.append(frame.digest)
            if frame.index == 66:
                proxy.drop()
        assert seen == wanted and playing.reconnects >= 1


def running(server: pliant.LocalServer) -> bool:
    with urllib.request.urlopen(f"{server.url}/metrics") as answer:
        return "pliant_animations 0" not in answer.read().decode()


def test_leaving_early_stops_it(server: pliant.LocalServer) -> None:
    with pliant.open(bar(), server=server) as session:
        with session.animate(bvh=clip(100), rig=RIG, fps=10000) as playing:
            assert next(playing).count > 10000 and running(server)
        while running(server):
            time.sleep(0.01)
        assert list(playing) == []


ENCODINGS: tuple[Literal["u16", "meshopt", "delta"], ...] = ("u16", "meshopt", "delta")


def test_asynchronously_it_is_the_same(server: pliant.LocalServer) -> None:
    with pliant.open(bar(), server=server) as session:
        exact = list(session.animate(bvh=clip(10), rig=RIG))
    wanted, shapes = [frame.digest for frame in exact], [frame.positions for frame in exact]

    async def work() -> None:
        async with pliant.aio.open(bar(), server=server) as session:
            for encoding in ENCODINGS:
                playing = session.animate(bvh=clip(10), rig=RIG, encoding=encoding)
                frames = [frame async for frame in playing]
                assert [frame.digest for frame in frames] == wanted
                assert all(np.abs(a.positions - b).max() < 1e-3 for a, b in zip(frames, shapes))
            assert playing.report is not None and playing.report.totals.frames == 10
            async with session.animate(bvh=clip(100), rig=RIG, fps=10000) as playing:
                assert (await playing.__anext__()).index == 0
            with pytest.raises(pliant.InvalidArgument):
                async for _ in session.animate("none"):
                    pass

    asyncio.run(asyncio.wait_for(work(), 120))
