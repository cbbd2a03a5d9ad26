"""A server of one's own: found, started on a free port of this machine, stopped when Python ends."""

from __future__ import annotations

import atexit
import json
import os
import shutil
import signal
import subprocess
import sysconfig
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from .errors import LocalServerError

# The shell waits for its standard input to end, which happens whichever way this process does, and then stops the
# server.
_WARDEN = (
    'exec 3<&0; "$@" 3<&- </dev/null & server=$!; { cat <&3 >/dev/null; kill $server; } 2>/dev/null >&2 & '
    "exec 3<&-; wait $server; code=$?; kill $! 2>/dev/null; exit $code"
)
_START_SECONDS = 30
_STOP_SECONDS = 10


def find_binary() -> str:
    """The `pliant` program: PLIANT_BIN, then the one that was installed with this package, then PATH, then a checkout's ``target/release``.

    A checkout is a folder above this file or above the working directory that holds the schema.
    """
    named = os.environ.get("PLIANT_BIN")
    if named:
        if not os.access(named, os.X_OK):
            raise LocalServerError(f"PLIANT_BIN is {named!r}, which is not a program that can be run")
        return named
    found = _installed() or shutil.which("pliant") or next(_built(), None)
    if found is None:
        raise LocalServerError(
            "found no pliant program: none came with this package (wheels for Linux bring one), and none is in PATH or in a checkout's "
            "target/release; build one with `cargo build --release`, name one in PLIANT_BIN, or give the address of a running server as "
            "server= or in PLIANT_SERVER"
        )
    return found


def _installed() -> str | None:
    """The program that a wheel brought; environments need not be activated for it."""
    for scheme in (None, sysconfig.get_preferred_scheme("user")):
        folder = sysconfig.get_path("scripts", scheme) if scheme else sysconfig.get_path("scripts")
        program = os.path.join(folder, "pliant")
        if os.access(program, os.X_OK):
            return program
    return None


def _built() -> Iterator[str]:
    for start in (Path(__file__).resolve(), Path.cwd().resolve() / "x"):
        for folder in start.parents:
            program = folder / "target" / "release" / "pliant"
            if (folder / "proto/pliant/v1/pliant.proto").is_file() and os.access(program, os.X_OK):
                yield str(program)


class LocalServer:
    """A `pliant serve` process on a free port of the loopback interface.

    Keywords are keys of the server's configuration: ``LocalServer(sessions=2, upload_bytes="64MiB")``. It is stopped by
    :meth:`stop`, at the end of a ``with`` block, and when this process ends in whatever way.
    """

    def __init__(self, binary: str | os.PathLike[str] | None = None, **keys: object) -> None:
        program = os.fspath(binary) if binary is not None else find_binary()
        flags = {"listen": "127.0.0.1:0", "log": "warn", "drain_deadline": "1s", **keys}
        command = [program, "serve"]
        for name, value in flags.items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            command.append(f"--{name.replace('_', '-')}={text}")
        self._log: IO[Any] = tempfile.TemporaryFile()
        if os.name == "posix":
            command = ["/bin/sh", "-c", _WARDEN, "pliant", *command]
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log, start_new_session=True
            )
        except OSError as problem:
            self._log.close()
            raise LocalServerError(f"{program} cannot be started: {problem.strerror}") from None
        atexit.register(self.stop)
        #: ``http://127.0.0.1:PORT``.
        self.url = self._listening(program)

    def _listening(self, program: str) -> str:
        assert self._process.stdout is not None
        late = threading.Timer(_START_SECONDS, self.stop)
        late.start()
        line = self._process.stdout.readline().decode(errors="replace").strip()
        late.cancel()
        if line.startswith("{"):
            # With log_format="json" the line has the form of the log.
            line = str(json.loads(line).get("message"))
        if not line.startswith("listening on "):
            words = self._words()
            self.stop()
            raise LocalServerError(f"{program} serve did not start: {words}")
        return line.removeprefix("listening on ")

    def _words(self) -> str:
        """Why the server ended, or if it does not say, the last of what it wrote."""
        try:
            self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            pass
        self._log.seek(0)
        lines = [line.strip() for line in self._log.read().decode(errors="replace").splitlines() if line.strip()]
        # The program's own last word begins with its name; hints on how it is used stand around it.
        reasons = [line for line in lines if line.startswith("pliant: ")]
        return " / ".join(reasons[-1:] or lines[-3:]) or "it said nothing"

    @property
    def ended(self) -> LocalServerError | None:
        """Why there is no server any more, or None while it runs."""
        code = self._process.poll()
        if code is None:
            return None
        if self._log.closed:
            return LocalServerError(f"the local server {self.url} was stopped")
        return LocalServerError(f"the local server {self.url} ended with code {code}: {self._words()}")

    def stop(self) -> None:
        """Stops the server and waits until it is gone. Sessions that it held are lost."""
        atexit.unregister(self.stop)
        process = self._process
        if process.stdin is not None and not process.stdin.closed:
            process.stdin.close()
        if os.name != "posix":
            process.terminate()
        try:
            process.wait(timeout=_STOP_SECONDS)
        except subprocess.TimeoutExpired:
            self.kill()
        if process.stdout is not None and threading.current_thread() is threading.main_thread():
            process.stdout.close()
        self._log.close()

    def kill(self) -> None:
        """Ends the server at once, as a crash would."""
        if os.name == "posix":
            try:
                os.killpg(self._process.pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
        else:
            self._process.kill()
        self._process.wait()

    def __enter__(self) -> LocalServer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()


_lock = threading.Lock()
_shared: LocalServer | None = None


def shared() -> LocalServer:
    """The server that all clients of this process share when no address is given; started when first asked for."""
    global _shared
    with _lock:
        if _shared is None or _shared.ended is not None:
            _shared = LocalServer()
        return _shared
