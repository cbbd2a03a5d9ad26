"""A server of one's own: found, shared, stopped, and gone whichever way Python ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import pliant
from conftest import binary
from pliant import server as local


def gone(pid: int) -> bool:
    """Whether a process ended (it may wait to be collected)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return True


def wait_gone(pid: int) -> bool:
    end = time.monotonic() + 15
    while not gone(pid) and time.monotonic() < end:
        time.sleep(0.05)
    return gone(pid)


def pid_of(url: str) -> int:
    """The process that listens on that port, by its command line."""
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
                command = (folder / "cmdline").read_bytes().split(b"\0")
            except (FileNotFoundError, ProcessLookupError):
                continue
            if len(command) > 1 and command[1] == b"serve" and str(parent) == url:
                return int(folder.name)
    raise AssertionError(f"no server under {url}")


def test_it_takes_a_free_port_and_is_gone_afterwards() -> None:
    with pliant.LocalServer(binary()) as one, pliant.LocalServer(binary()) as two:
        assert one.url != two.url and one.url.startswith("http://127.0.0.1:")
        assert one.ended is None
        assert pliant.connect(one).limits().sessions > 0
    assert one.ended is not None and "was stopped" in str(one.ended)
    one.stop()


def test_what_the_server_says_when_it_cannot_start_is_passed_on() -> None:
    with pytest.raises(pliant.LocalServerError, match="window"):
        pliant.LocalServer(binary(), window=100_000)
    with pytest.raises(pliant.LocalServerError, match="did not start: pliant: .*--frobnicate"):
        pliant.LocalServer(binary(), frobnicate=1)
    with pytest.raises(pliant.LocalServerError, match="did not start"):
        pliant.LocalServer("/no/such/program")


def test_the_program_is_looked_for_where_the_texts_say(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    real = binary()
    for name in ("PLIANT_BIN", "PLIANT_SERVER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(local, "_built", lambda: iter(()))
    with pytest.raises(pliant.LocalServerError, match="cargo build --release"):
        local.find_binary()
    (tmp_path / "pliant").symlink_to(real)
    assert local.find_binary() == str(tmp_path / "pliant")
    monkeypatch.setenv("PLIANT_BIN", real)
    assert local.find_binary() == real
    monkeypatch.setenv("PLIANT_BIN", "/no/such/program")
    with pytest.raises(pliant.LocalServerError, match="PLIANT_BIN"):
        local.find_binary()


def test_a_checkout_is_known_by_its_schema(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program = tmp_path / "target/release/pliant"
    program.parent.mkdir(parents=True)
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    below = tmp_path / "a/b"
    below.mkdir(parents=True)
    monkeypatch.chdir(below)
    assert str(program) not in list(local._built())
    (tmp_path / "proto/pliant/v1").mkdir(parents=True)
    (tmp_path / "proto/pliant/v1/pliant.proto").touch()
    assert str(program) in list(local._built())


def test_the_environment_may_name_a_server(server: pliant.LocalServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLIANT_SERVER", server.url)
    assert pliant.connect().url == server.url


def test_a_token_tells_the_server_who_asks(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made = subprocess.run([binary(), "token", "studio"], capture_output=True, text=True, check=True).stdout
    token, lines = made.split("\n\n", 1)
    config = tmp_path / "pliant.toml"
    config.write_text(lines)
    monkeypatch.delenv("PLIANT_TOKEN", raising=False)
    with pliant.LocalServer(binary(), config=config) as server:
        for wrong in (None, "pliant_of-another-server"):
            with pliant.connect(server, token=wrong) as client, pytest.raises(pliant.Unauthenticated, match="token"):
                client.limits()
        with pliant.connect(server, token=token) as client:
            assert client.limits().vertices > 0
        monkeypatch.setenv("PLIANT_TOKEN", token)
        with pliant.connect(server) as client:
            assert client.limits().vertices > 0


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc to see processes")
@pytest.mark.parametrize("ending", ["returns", "raises", "is killed", "is interrupted"])
def test_no_server_is_left_when_python_ends(ending: str, creature: Path) -> None:
    script = (
        "import os, pliant, signal, sys\n"
        f"session = pliant.open({str(creature)!r})\n"
        "server = pliant.server.shared()\n"
        "assert pliant.connect().url == server.url, 'clients share it'\n"
        "print(server._process.pid, flush=True)\n"
        "sys.stdin.readline()\n"
        f"if {ending!r} == 'raises': raise SystemExit(3)\n"
    )
    environment = {**os.environ, "PLIANT_BIN": binary()}
    environment.pop("PLIANT_SERVER", None)
    python = subprocess.Popen(
        [sys.executable, "-c", script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
    )
    assert python.stdin is not None and python.stdout is not None
    warden = python.stdout.readline().decode().strip()
    running = pid_of(warden)
    assert not gone(running)
    if ending == "is killed":
        python.kill()
    elif ending == "is interrupted":
        python.send_signal(signal.SIGINT)
    python.stdin.close()
    python.wait(timeout=30)
    assert wait_gone(running) and wait_gone(int(warden))


def test_the_package_runs_the_program_that_it_finds(tmp_path: Path) -> None:
    environment = {**os.environ, "PLIANT_BIN": binary()}
    command = [sys.executable, "-m", "pliant"]
    done = subprocess.run([*command, "--version"], env=environment, capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout == subprocess.run([binary(), "--version"], capture_output=True, text=True).stdout
    environment["PLIANT_BIN"] = str(tmp_path / "nothing")
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 1 and done.stderr.startswith("pliant: ") and "Traceback" not in done.stderr
