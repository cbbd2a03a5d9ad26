"""The README's code runs, in order, in a folder that has what it says: the server's creature and figure."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import pliant
from conftest import PACKAGE

BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", (PACKAGE / "README.md").read_text(), re.MULTILINE | re.DOTALL)
PYTHON = [text for language, text in BLOCKS if language == "python"]


@pytest.mark.parametrize("block", PYTHON, ids=lambda text: text.strip().splitlines()[0][:30])
def test_a_block_of_python_runs(
    block: str,
    server: pliant.LocalServer,
    creature: Path,
    figure: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shutil.copy(figure, tmp_path / "figure.glb")
    shutil.copy(creature, tmp_path / "creature.glb")
    script = tmp_path / "block.py"
    script.write_text(f"import numpy as np\nimport pliant\n\n{block}")
    environment = {**os.environ, "PLIANT_SERVER": server.url}
    done = subprocess.run([sys.executable, script], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_every_exception_is_in_the_table() -> None:
    table = (PACKAGE / "README.md").read_text().split("| exception |")[1].split("\n\n")[0]
    for name in pliant.__all__:
        thing = getattr(pliant, name)
        if isinstance(thing, type) and issubclass(thing, Exception) and thing is not pliant.PliantError:
            assert f"`{name}`" in table, f"{name} is missing"
