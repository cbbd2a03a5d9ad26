"""The link to a server: one session for each object's rest shape, kept while the shape stays the same."""

from __future__ import annotations

import filecmp
import os
import shutil
import sys
from ipaddress import ip_address
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import bpy

from . import handles, mesh, preferences

#: The program that extensions for Linux bring.
_CARRIED = Path(__file__).parent / "bin/pliant"
_NAME_ONE = "write its address into the add-on's preferences, under Server"

try:
    import pliant
except ImportError as missing:  # told in the panel, where it can be read
    pliant = None
    MISSING = f"the Python package pliant is not installed for Blender: {missing}"
else:
    MISSING = ""


class Link:
    """One open session and what it was opened with."""

    def __init__(self, client: Any, session: Any, fingerprint: tuple[Any, ...]) -> None:
        self.client = client
        self.session = session
        self.fingerprint = fingerprint
        #: The handles that it holds, as bytes.
        self.handles: list[tuple[str, bytes, float]] = []

    def close(self) -> None:
        """Ends the session and its connection."""
        self.session.close()
        self.client.close()


_links: dict[str, Link] = {}
_server: Any = None


def session(object: bpy.types.Object) -> Any:
    """The session of an object's rest shape, with the object's handles; opened where there is none that fits."""
    named = handles.regions(object)
    points, corners = mesh.rest(object), mesh.triangles(object)
    created = _created(object)
    way = preferences.way()
    fingerprint = (points.tobytes(), corners.tobytes(), *created.values(), *way)
    link = _links.get(object.name)
    if link is not None and (link.fingerprint != fingerprint or not _alive(link)):
        close(object.name)
        link = None
    if link is None:
        link = _links[object.name] = _opened(object, (points, corners), fingerprint)
    # Handles are sent when they changed; setting them costs more than a pose.
    wanted = [(group, weights.tobytes(), stiffness) for group, (weights, stiffness) in named.items()]
    if link.handles != wanted:
        link.handles = []
        handles.declare(link.session, named)
        link.session.apply()
        link.handles = wanted
    return link.session


def opened(object: bpy.types.Object, model: bytes) -> Link:
    """A session of its own with a model file; the caller closes it."""
    return _opened(object, model, ())


def _opened(object: bpy.types.Object, model: Any, fingerprint: tuple[Any, ...]) -> Link:
    client = _connect(*preferences.way())
    try:
        return Link(client, client.open(model, label=object.name[:100], **_created(object)), fingerprint)
    except Exception:
        client.close()
        raise


def _created(object: bpy.types.Object) -> dict[str, Any]:
    """How a session of the object is built."""
    settings = object.pliant
    return {"volume_graph": settings.volume_graph.lower(), "components": settings.components.lower()}


def refusal() -> str:
    """Why nothing can be computed as things are set; empty where it can be tried."""
    server, _, program = preferences.way()
    server = server or os.environ.get("PLIANT_SERVER", "")
    if MISSING:
        return MISSING
    if server:
        if bpy.app.online_access or _is_here(server):
            return ""
        return "Blender may not use the network: allow it in the preferences, System > Network > Allow Online Access"
    if sys.platform == "win32":
        return f"no server runs on Windows: start one on a machine with Linux, and {_NAME_ONE}"
    if sys.platform == "darwin" and not program and not os.environ.get("PLIANT_BIN") and shutil.which("pliant") is None:
        return f"no program is made for macOS: start one on a machine with Linux, and {_NAME_ONE}"
    return ""


def _is_here(server: str) -> bool:
    """Whether an address is this machine's own, or none, which the client refuses: neither needs the network."""
    try:
        name = urlsplit(server if "//" in server else f"//{server}").hostname or ""
        if not name or " " in name:
            return True
        return name == "localhost" or ip_address(name).is_loopback
    except ValueError:
        return False


def _program(named: str) -> str:
    """The program to start: the one that is named, else the one that came with the add-on; empty looks in PATH."""
    if named or os.environ.get("PLIANT_BIN") or not _CARRIED.is_file():
        return named
    if os.access(_CARRIED, os.X_OK):
        return str(_CARRIED)
    # Blender unpacks it without the right to run, and what it has unpacked is not for extensions to change.
    folder = bpy.utils.extension_path_user(__package__, path="bin", create=True)
    if not folder:
        raise mesh.Refusal(f"no folder for the program can be made beside Blender's settings: {_NAME_ONE}")
    program = Path(folder, "pliant")
    if not program.is_file() or not filecmp.cmp(_CARRIED, program):
        fresh = program.with_name(f"pliant-{os.getpid()}")
        shutil.copy2(_CARRIED, fresh)
        fresh.chmod(0o755)
        # At once, so that another Blender runs the one or the other.
        fresh.replace(program)
    return str(program)


def _connect(server: str, token: str, program: str) -> Any:
    global _server
    why = refusal()
    if why:
        raise mesh.Refusal(why)
    program = _program(program)
    server = server or os.environ.get("PLIANT_SERVER", "")
    if not server and program:
        if _server is None or _server.ended is not None:
            _server = pliant.LocalServer(program)
        return pliant.connect(_server, token=token or None)
    return pliant.connect(server or None, token=token or None)


def _alive(link: Link) -> bool:
    try:
        link.session.refresh()
    except pliant.Unavailable:
        # Of a server that is away nothing is known: it may come back, and the session with it.
        raise
    except pliant.PliantError:
        return False
    return True


def options(object: bpy.types.Object) -> dict[str, Any]:
    """How a final result is solved. Only where no number of re-fits is given does the server look for folds."""
    settings = object.pliant
    refine = {} if settings.refine < 0 else {"refine": settings.refine}
    return {"tolerance": settings.tolerance, **refine}


def words(error: Exception) -> str:
    """An error as a line for the status bar."""
    text = str(error)
    return text[:1].upper() + text[1:]


def is_failure(error: Exception) -> bool:
    """Whether an exception is one to show to people, rather than a defect of this add-on."""
    return isinstance(error, (mesh.Refusal, ValueError, OSError)) or (
        pliant is not None and isinstance(error, pliant.PliantError)
    )


def result(object: bpy.types.Object, frame: Any) -> None:
    """Notes what a result was like, for the panel."""
    quality = frame.quality
    object.pliant.told = f"{frame.solve_ms:.0f} ms, error at most {100 * frame.max_error:.2g} % of the size"
    if quality is not None:
        volume = "n/a" if quality.open_surface else f"{100 * quality.volume_change:+.1f} %"
        object.pliant.told += f"; volume {volume}, {quality.flipped_triangles} flipped"


def close(name: str) -> None:
    """Ends the session of an object."""
    link = _links.pop(name, None)
    if link is not None:
        link.close()


def close_all() -> None:
    """Ends all sessions, and the server if it is our own."""
    global _server
    for name in list(_links):
        close(name)
    if _server is not None:
        _server.stop()
        _server = None
