"""What the tests share: a server, models, the command line, and a connection that can be cut."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import threading
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pliant
from pliant.server import find_binary

PACKAGE = Path(__file__).resolve().parents[1]
ROOT = PACKAGE.parents[2]


def binary() -> str:
    try:
        return find_binary()
    except pliant.LocalServerError as problem:
        pytest.skip(f"needs a server: {problem}")


@pytest.fixture(scope="session")
def server() -> Iterator[pliant.LocalServer]:
    """A server that many tests share."""
    with pliant.LocalServer(binary()) as running:
        yield running


@pytest.fixture(scope="session")
def creature(server: pliant.LocalServer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built-in creature as a file."""
    path = tmp_path_factory.mktemp("creature") / "creature.glb"
    with urllib.request.urlopen(f"{server.url}/v1/sample.glb") as answer:
        path.write_bytes(answer.read())
    return path


@pytest.fixture(scope="session")
def figure(server: pliant.LocalServer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built-in figure, which is skinned and has clips, as a file."""
    path = tmp_path_factory.mktemp("figure") / "figure.glb"
    with urllib.request.urlopen(f"{server.url}/v1/sample.glb?name=figure") as answer:
        path.write_bytes(answer.read())
    return path


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of test models."""
    folder = Path(os.environ.get("PLIANT_DATA", ROOT.parent / "shared/data"))
    if not folder.is_dir():
        pytest.skip(f"there is no folder of test models at {folder} (PLIANT_DATA names one)")
    return folder


def bar(cells: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """A closed square bar along z from 0 to 4: vertices and triangles."""
    ring = np.array([[x, y] for x, y in [(-1, -1), (0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0)]]) * 0.25
    z = np.linspace(0, 4, cells + 1)
    sides = np.array([[x, y, h] for h in z for x, y in ring])
    caps = np.array([[0, 0, 0], [0, 0, 4.0]])
    faces = []
    for k in range(cells):
        for i in range(8):
            a, b = 8 * k + i, 8 * k + (i + 1) % 8
            faces += [[a, b, b + 8], [a, b + 8, a + 8]]
    low, high, top = len(sides), len(sides) + 1, 8 * cells
    for i in range(8):
        j = (i + 1) % 8
        faces += [[low, j, i], [high, top + i, top + j]]
    return np.vstack([sides, caps]), np.array(faces)


def deform(model: Path, job: dict[str, Any], folder: Path, output: str = "out.ply") -> dict[str, Any]:
    """What `pliant deform` makes of a job: its report."""
    written = folder / "job.json"
    written.write_text(json.dumps(job))
    command = [binary(), "deform", str(model), "--job", str(written), "-o", str(folder / output)]
    done = subprocess.run([*command, "--json", "--force", "--parents"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    report: dict[str, Any] = json.loads(done.stdout)
    return report


class Proxy:
    """A way to a server that can be cut: `drop` closes what is open, `shut` also refuses what comes, and after `freeze` what is open
    stays open and says nothing, as a server that stands still does."""

    def __init__(self, url: str) -> None:
        host, port = url.removeprefix("http://").split(":")
        self._target = (host, int(port))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self._open: list[socket.socket] = []
        self._shut = False
        self._frozen: set[socket.socket] = set()
        self.connections = 0
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            if self._shut:
                near.close()
                continue
            self.connections += 1
            try:
                far = socket.create_connection(self._target)
            except OSError:
                # The server is away for now; what comes later may find it.
                near.close()
                continue
            self._open += [near, far]
            for one, other in ((near, far), (far, near)):
                threading.Thread(target=self._pump, args=(one, other), daemon=True).start()

    def _pump(self, one: socket.socket, other: socket.socket) -> None:
        try:
            while data := one.recv(1 << 16):
                if one not in self._frozen:
                    other.sendall(data)
        except OSError:
            pass
        for end in (one, other):
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass

    def drop(self) -> None:
        for end in self._open:
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
        self._open = []

    def freeze(self) -> None:
        self._frozen |= set(self._open)

    def shut(self, shut: bool = True) -> None:
        self._shut = shut
        if shut:
            self.drop()

    def close(self) -> None:
        self.drop()
        self._listener.close()


@pytest.fixture
def proxy(server: pliant.LocalServer) -> Iterator[Proxy]:
    way = Proxy(server.url)
    yield way
    way.close()
