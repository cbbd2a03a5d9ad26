"""The README's code runs, in order, in a folder that has what it says: the server's creature."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import pliant
from conftest import PACKAGE, ROOT

BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", (PACKAGE / "README.md").read_text(), re.MULTILINE | re.DOTALL)
PYTHON = [text for language, text in BLOCKS if language == "python"]


def shell(first_words: str) -> str:
    [found] = [text for language, text in BLOCKS if language == "sh" and text.startswith(first_words)]
    return found.strip()


CSHARP = "protoc -I proto --csharp_out target/csharp "


@pytest.mark.parametrize("block", PYTHON, ids=lambda text: text.strip().splitlines()[0][:30])
def test_a_block_of_python_runs(
    block: str, server: pliant.LocalServer, creature: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder like a checkout's root, for commands that write below target/."""
    if not (ROOT / "proto/pliant/v1/pliant.proto").is_file():
        pytest.skip("this is no checkout")
    (tmp_path / "proto").symlink_to(ROOT / "proto")
    for name in ("cpp", "csharp"):
        (tmp_path / "target" / name).mkdir(parents=True)
    return tmp_path


def run(command: str, folder: Path) -> str:
    # `python` is the one that runs the tests.
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["sh", "-c", command], cwd=folder, env={**os.environ, "PATH": path}, capture_output=True, text=True
    )
    assert done.returncode == 0, f"{command}\n{done.stderr}"
    return done.stdout


def need(*programs: str) -> None:
    for program in programs:
        if shutil.which(program) is None:
            pytest.skip(f"there is no {program}")


def test_messages_for_csharp_are_made(checkout: Path) -> None:
    need("protoc")
    run(shell(f"{CSHARP}pliant"), checkout)
    made = (checkout / "target/csharp/Pliant.cs").read_text()
    assert "namespace Pliant.V1" in made and "class SessionRequest" in made and "SessionId" in made


def test_calls_for_csharp_are_made(checkout: Path) -> None:
    need("protoc", "grpc_csharp_plugin")
    run(shell(f"{CSHARP}--grpc_out"), checkout)
    assert "class DeformerClient" in (checkout / "target/csharp/PliantGrpc.cs").read_text()


def test_the_program_in_cpp_bends_the_creature(checkout: Path, server: pliant.LocalServer, creature: Path) -> None:
    need("protoc", "grpc_cpp_plugin", "g++", "pkg-config")
    if subprocess.run(["pkg-config", "--exists", "grpc++", "protobuf"]).returncode != 0:
        pytest.skip("the libraries grpc++ and protobuf are not installed")
    run(shell("protoc -I proto --cpp_out"), checkout)
    [program] = [text for language, text in BLOCKS if language == "cpp"]
    (checkout / "target/cpp/bend.cpp").write_text(program)
    run(shell("g++"), checkout)
    said = run(f"target/cpp/bend {server.url.removeprefix('http://')} {creature}", checkout)
    with pliant.open(creature, server=server) as session:
        assert said == f"{session.vertices} vertices\n"
