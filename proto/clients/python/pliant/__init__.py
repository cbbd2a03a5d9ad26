"""Bends large meshes through the pliant deformation service.

    import pliant

    with pliant.open("creature.glb") as s:
        s.handle("feet", half_space=((0, -1, 0), -0.14))
        s.handle("head", sphere=((0.76, 1.22, 0), 0.36))
        positions = s.solve({"head": {"rotation_vector": (0, 0.8, 0)}})
        s.export("turned.glb")

The same with ``async`` is in :mod:`pliant.aio`. Failures are exceptions of :mod:`pliant.errors`.
"""

from importlib.metadata import PackageNotFoundError, version

from .animation import AnimatedFrame
from .books import Commit
from .carried import Carried
from .channel import Settings
from .client import Client, connect, open
from .edits import EditResult
from .errors import (
    Aborted,
    AlreadyExists,
    Cancelled,
    DeadlineExceeded,
    FailedPrecondition,
    Internal,
    InvalidArgument,
    LocalServerError,
    NotFound,
    PermissionDenied,
    PliantError,
    ResourceExhausted,
    SessionLost,
    TooLarge,
    Unauthenticated,
    Unavailable,
    Unimplemented,
)
from .frames import Frame, SolvedFrame
from .guides import Cage, Curve, GuidePose, Lattice
from .player import Animation
from .poses import Pose, Targets
from .server import LocalServer
from .session import Session
from .stream import Stream
from .transfers import Transferred
from .v1.pliant_pb2 import Quality

try:
    __version__ = version("pliant")
except PackageNotFoundError:  # used from a folder that was not installed
    __version__ = "0"

__all__ = [
    "Aborted",
    "AlreadyExists",
    "AnimatedFrame",
    "Animation",
    "Cage",
    "Cancelled",
    "Carried",
    "Client",
    "Commit",
    "Curve",
    "DeadlineExceeded",
    "EditResult",
    "FailedPrecondition",
    "Frame",
    "GuidePose",
    "Internal",
    "InvalidArgument",
    "Lattice",
    "LocalServer",
    "LocalServerError",
    "NotFound",
    "PermissionDenied",
    "PliantError",
    "Pose",
    "Quality",
    "ResourceExhausted",
    "Session",
    "SessionLost",
    "Settings",
    "SolvedFrame",
    "Stream",
    "Targets",
    "TooLarge",
    "Transferred",
    "Unauthenticated",
    "Unavailable",
    "Unimplemented",
    "__version__",
    "connect",
    "open",
]


def __dir__() -> list[str]:
    # What completion shows: the names above, and the modules that people import. The others are how it is made.
    return sorted([*__all__, *({"aio", "batch", "errors", "notebook"} & globals().keys())])
