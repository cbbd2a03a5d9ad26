"""The README's script runs, and its table quotes real texts."""

from __future__ import annotations

import re
from pathlib import Path

import bpy

from pliant_addon import link

HERE = Path(__file__).resolve().parent
README = (HERE.parent / "README.md").read_text()


SCRIPTS = re.findall(r"^```python\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


def test_the_scripts_bend_a_bar_and_animate_it() -> None:
    assert len(SCRIPTS) == 2
    for script in SCRIPTS:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        exec(compile(script, "README.md", "exec"), {"__name__": "__main__"})
        link.close_all()


def test_the_table_quotes_what_the_code_says() -> None:
    sources = " ".join(path.read_text() for path in (HERE.parent / "pliant_addon").glob("*.py"))
    table = README.split("| it says | because |")[1].split("\n\n")[0]
    rows = [line.split("|")[1].strip() for line in table.splitlines() if line.startswith("| ") and "---" not in line]
    assert len(rows) == 13
    for row in rows:
        if row.startswith("the matrix"):
            continue  # said by the Python package, whose own tests hold it
        for piece in row.replace('"', "").replace(", no", "…no").split("…"):
            words = piece.strip(' ":')
            assert words.split(" to")[0] in sources.replace('"', ""), f"nothing says {words!r}"
