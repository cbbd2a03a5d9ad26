"""Two hundred poses of the armadillo, each equal to the bit to what `pliant deform` makes of the same job."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import pliant
from conftest import binary, deform

POSES = 200


def arm(k: int) -> dict[str, list[float]]:
    """The pose of the hand at step k: up and down, and turning."""
    swing = math.sin(2 * math.pi * k / 50)
    return {"rotation_vector": [0.4 * swing, 0.0, 0.9 * swing], "translation": [0.0, 0.02 * swing, 0.01 * k / POSES]}


def test_two_hundred_poses_equal_the_command_line(data: Path, tmp_path: Path) -> None:
    model = data / "meshes/armadillo.obj"
    if not model.is_file():
        pytest.skip(f"there is no {model}")
    positions = np.array([line.split()[1:4] for line in model.read_text().splitlines() if line.startswith("v ")], float)
    low, high = positions.min(axis=0), positions.max(axis=0)
    floor = float(low[1] + 0.12 * (high[1] - low[1]))
    # The hand that reaches furthest along x.
    tip = positions[positions[:, 0].argmax()]
    radius = float(0.12 * (high[0] - low[0]))
    options = {"tolerance": 1e-3, "refine": 0}
    job = {
        "create": {"volumeGraph": {"mode": "OFF"}},
        "handles": [
            {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -floor}}},
            {"id": "hand", "region": {"sphere": {"center": tip.tolist(), "radius": radius}}},
        ],
        "steps": [
            {
                "pose": {
                    "handles": [
                        {
                            "id": "hand",
                            "pose": {"rotationVector": arm(k)["rotation_vector"], "translation": arm(k)["translation"]},
                        }
                    ]
                }
            }
            for k in range(POSES)
        ],
        "options": options,
    }
    report = deform(model, job, tmp_path, "out.obj")
    wanted = [step["digest"] for step in report["steps"]]
    assert len(wanted) == POSES and len(set(wanted)) > POSES / 2

    with pliant.LocalServer(binary(), history=POSES + 10) as server:
        with pliant.open(model, server=server, volume_graph="off") as session:
            session.handle("feet", half_space=((0, -1, 0), -floor))
            session.handle("hand", sphere=(tip, radius))
            poses = ({"hand": arm(k)} for k in range(POSES))
            count = 0
            for frame in session.drag(poses, commit=True, tolerance=1e-3, refine=0):
                count += 1
                assert frame.positions.shape == (session.vertices, 3)
            assert count == POSES
            found = [commit.digest for commit in session.history() if commit.kind == "pose"]
            assert found == wanted, "every pose has the bits of the command line"
            [written] = session.export(tmp_path / "mine.obj")
            assert written.read_bytes() == (tmp_path / "out.obj").read_bytes()

            # The last poses dragged: near the recorded ones, within the tolerance that both were solved to.
            diagonal = float(np.linalg.norm(high - low))
            for frame in session.drag([{"hand": arm(k)} for k in range(POSES - 10, POSES)], tolerance=1e-6):
                pass
            exact = session.solve({"hand": arm(POSES - 1)}, tolerance=1e-6, refine=0)
            assert np.linalg.norm(frame.positions - exact, axis=1).max() < 1e-3 * diagonal
