"""What a user's type checker says of code that uses the package: nothing."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

USER = """
import numpy as np
import pliant
import pliant.aio

with pliant.open("creature.glb", progress=True, volume_graph="off") as session:
    session.handle("feet", half_space=((0, -1, 0), -0.14))
    session.handle("head", vertices=session.positions()[:, 1] > 1, stiffness=2.0, falloff=(0.2, "smooth"))
    frame = session.solve_frame({"head": {"translation": (0, 0.1, 0)}, "feet": np.eye(4)}, normals=True)
    quality: pliant.Quality = frame.quality
    print(quality.flipped_triangles + 1, frame.quality.edge_rms * 2)
    for moved in session.drag([{"head": {"rotation_degrees": (0, 5, 0)}}], latest=True):
        print(moved.positions.shape, moved.solve_ms)
    with session.stream() as stream:
        stream.send({"head": pliant.Pose(scale=2.0)})
        print(stream.commit().quality.volume_change, [path.name for path in session.export("bent.gltf")])
    print(session.triangles()[:, 0], session.to_trimesh())
    print(session.history()[-1].digest, session.edit(subdivide={"scheme": "loop"}).after, pliant.__version__)


async def main() -> float:
    async with pliant.aio.open("creature.glb") as other:
        return (await other.solve_frame({})).quality.max_stretch
"""


def test_code_that_uses_it_passes_a_strict_check(tmp_path: Path) -> None:
    if importlib.util.find_spec("mypy") is None:
        pytest.skip("mypy is not installed")
    script = tmp_path / "user.py"
    script.write_text(USER)
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path / "cache"), str(script)]
    checked = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert checked.returncode == 0, checked.stdout
    # The same check finds what is wrong: the package is typed, not silent.
    script.write_text(USER.replace("edge_rms", "edge_rns"))
    checked = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert checked.returncode == 1 and "edge_rns" in checked.stdout
