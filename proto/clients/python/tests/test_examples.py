"""Every example runs as its reader would run it, in an empty folder."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import pliant
from conftest import PACKAGE, ROOT

EXAMPLES = sorted((PACKAGE / "examples").glob("*.py"))
#: What examples import beside the package; trimesh looks for scipy when it is asked for normals, and does not require it.
NEEDS = {"batch": ("tqdm",), "with_trimesh": ("trimesh", "scipy"), "with_pygltflib": ("pygltflib",)}


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_it_runs(example: Path, server: pliant.LocalServer, tmp_path: Path) -> None:
    for needed in NEEDS.get(example.stem, ()):
        if importlib.util.find_spec(needed) is None:
            pytest.skip(f"{needed} is not installed")
    environment = {**os.environ, "PLIANT_SERVER": server.url}
    done = subprocess.run([sys.executable, example], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    print(done.stdout)
    if example.stem == "batch":
        files = sorted((tmp_path / "poses").iterdir())
        assert len(files) == 100
        assert files[0].read_bytes() == pliant.connect(server).sample(), "the first pose is at rest"
        # The head nods back through the angles it came by, so that about half of the shapes come twice.
        assert len({path.read_bytes() for path in files}) > 50


def test_the_samples_of_the_reference_page_run(server: pliant.LocalServer, tmp_path: Path) -> None:
    samples = ROOT / "src/server/src/openapi/samples.py"
    if not samples.is_file():
        pytest.skip("this is not a checkout")
    script = samples.read_text().replace("http://127.0.0.1:7411", server.url)
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_extra_for_examples_has_what_they_need() -> None:
    extra = re.search(r"^examples = \[(.*)\]$", (PACKAGE / "pyproject.toml").read_text(), re.MULTILINE)
    assert extra is not None
    for needed in (name for names in NEEDS.values() for name in names):
        assert f'"{needed}>=' in extra[1], f"{needed} is missing: pip install 'pliant[examples]' is what readers are told"


def test_there_are_examples() -> None:
    assert {"bend", "batch", "changed", "with_trimesh", "with_pygltflib"} <= {path.stem for path in EXAMPLES}
