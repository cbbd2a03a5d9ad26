"""Registers the add-on once for all tests."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import bpy  # noqa: E402, F401  (before the add-on, which expects to live in Blender)
import pliant_addon  # noqa: E402
from pliant.server import LocalServerError, find_binary  # noqa: E402


@pytest.fixture(scope="session", autouse=True)
def addon() -> Iterator[None]:
    try:
        find_binary()
    except LocalServerError as problem:
        pytest.skip(f"needs a server: {problem}")
    pliant_addon.register()
    yield
    pliant_addon.unregister()
