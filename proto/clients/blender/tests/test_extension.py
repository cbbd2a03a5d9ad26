"""The packed extension, installed as Blender installs it from disk, where nothing else of pliant is."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import bpy
import pytest

from pliant.server import find_binary

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[3]
SCRIPT = re.findall(r"^```python\n(.*?)^```$", (HERE.parent / "README.md").read_text(), re.MULTILINE | re.DOTALL)[0]

INSTALL = """
import sys
from pathlib import Path

import bpy

archive, home = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.preferences.addon_enable(module="bl_pkg")
# Blender itself has no other packages than its own; the environment of this test has.
packages = Path(home, f"extensions/.local/lib/python{sys.version_info[0]}.{sys.version_info[1]}/site-packages")
packages.mkdir(parents=True)
sys.path.insert(0, str(packages))
how = {"repo": "user_default", "enable_on_install": True}
assert bpy.ops.extensions.package_install_files(filepath=archive, **how) == {"FINISHED"}
import pliant
from bl_ext.user_default.pliant_addon import link

assert Path(pliant.__file__).is_relative_to(home), pliant.__file__
"""


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The extension for this machine, with the program that is tested."""
    command = [HERE.parent / "build", "--program", find_binary()]
    made = subprocess.run(command, env={**os.environ, "PYTHON": sys.executable}, capture_output=True, text=True)
    if made.returncode != 0 and "No matching distribution" in made.stderr:
        pytest.skip("packages cannot be fetched")
    assert made.returncode == 0, made.stderr
    return ROOT / "target/blender/pliant_addon.zip"


def test_blender_accepts_the_archive(archive: Path) -> None:
    cli = next(Path(bpy.utils.system_resource("SCRIPTS")).rglob("bl_pkg/cli/blender_ext.py"))
    checked = subprocess.run([sys.executable, cli, "validate", archive], capture_output=True, text=True)
    assert checked.returncode == 0 and "Success" in checked.stdout, checked.stdout + checked.stderr
    manifest = zipfile.ZipFile(archive).read("blender_manifest.toml").decode()
    assert re.search(r'^platforms = \["linux-(x64|arm64)"\]$', manifest, re.MULTILINE), manifest


def test_it_bends_a_bar_with_the_program_that_it_brought(archive: Path, tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    told = """
import json
import os

rights = [os.access(program, os.X_OK) for program in (link._CARRIED, link._program(""))]
print("TOLD", json.dumps([link._program(""), rights, bar.pliant.told]))
"""
    script = tmp_path / "install.py"
    script.write_text(f"{INSTALL}\n{SCRIPT}\n{told}\n")
    env = {"PATH": "/usr/bin:/bin", "BLENDER_USER_RESOURCES": str(home), "HOME": str(home)}
    command = [sys.executable, str(script), str(archive), str(home)]
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    program, rights, words = json.loads(done.stdout.split("TOLD ")[1].splitlines()[0])
    assert Path(program) == home / "extensions/.user/user_default/pliant_addon/bin/pliant"
    assert rights == [False, True], "the extension's own folder stays as Blender has unpacked it"
    assert [file.name for file in Path(program).parent.iterdir()] == ["pliant"]
    assert "error at most" in words
