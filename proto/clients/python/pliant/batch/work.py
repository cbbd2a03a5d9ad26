"""What a worker does: a job on a server, from the model's bytes to the bytes of the result.

A worker is a process (or a thread) of whatever executor runs the batch. It keeps its server and its connection for the next job.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import threading
import time
from dataclasses import dataclass, field
from typing import Any

from .. import channel, errors, model
from ..calls import Calls
from ..channel import Settings
from ..client import Client
from ..options import create_options
from ..server import LocalServer, find_binary
from ..v1 import pliant_pb2 as pb
from .jobs import Task
from .riders import Riders

#: Seconds that a worker waits at most when its server says when to come back, before it gives the job back.
_PAUSE = 5.0


@dataclass(frozen=True)
class Place:
    """Where workers find a server."""

    #: Its address, or None for one of the worker's own.
    server: str | None
    #: Configuration of the worker's own.
    keys: tuple[tuple[str, Any], ...]
    #: How to reach it: fields of :class:`pliant.Settings`.
    way: tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class Outcome:
    """What a worker made of a job. It travels, and so does a failure: as what it says."""

    worker: str
    seconds: float
    digest: str = ""
    #: A ``pb.Quality`` of the last pose, where the last step is one.
    quality: bytes | None = None
    #: The files by name.
    files: dict[str, bytes] = field(default_factory=dict)
    #: A ``pb.Report.Passenger`` for each of what rode along and is not a part of the model.
    passengers: tuple[bytes, ...] = ()
    #: Where it failed, the code, the words, and the field to blame.
    failure: tuple[str, str, str, str | None] | None = None
    #: Whether it failed for reasons that lie outside the job, so that another try may go better.
    passing: bool = False


def version(place: Place) -> str:
    """The version that a server has, or that one's own will have."""
    if place.server is not None:
        way = dict(place.way)
        way.setdefault("token", os.environ.get("PLIANT_TOKEN"))
        told = json.loads(Settings(place.server, **way).get("/openapi.json"))
        return str(told["info"]["version"])
    program = find_binary()
    try:
        done = subprocess.run([program, "--version"], capture_output=True, text=True, timeout=60, check=True)
    except (OSError, subprocess.SubprocessError) as problem:
        raise errors.LocalServerError(f"{program} does not report its version: {problem}") from None
    return done.stdout.strip().removeprefix("pliant ")


def probe(place: Place) -> tuple[str, str, str]:
    """Whether a worker can work: its name, its server's version, and what prevents it, or nothing."""
    try:
        return _name(), _connected(place)[1], ""
    except errors.PliantError as problem:
        return _name(), "", problem.message


def work(task: Task, place: Place) -> Outcome:
    """Runs one job; whatever goes wrong with it is answered, and not raised."""
    began = time.monotonic()
    where = ["worker"]
    try:
        client, found = _connected(place)
        if found != task.version:
            raise errors.FailedPrecondition(f"its server has version {found}, this batch is for {task.version}")
        digest, quality, files, passengers = _run(client, task, where)
    except errors.PliantError as error:
        passing = _may_pass(error)
        if passing and error.retry_after:
            time.sleep(min(error.retry_after, _PAUSE))
        failure = (where[0], error.code, error.message, error.field)
        return Outcome(_name(), time.monotonic() - began, failure=failure, passing=passing)
    except Exception as defect:
        failure = (where[0], "INTERNAL", f"{type(defect).__name__}: {defect}", None)
        return Outcome(_name(), time.monotonic() - began, failure=failure)
    return Outcome(_name(), time.monotonic() - began, digest, quality, files, passengers)


def _run(client: Client, task: Task, where: list[str]) -> tuple[str, bytes | None, dict[str, bytes], tuple[bytes, ...]]:
    job = pb.Job.FromString(task.job)
    options = create_options({})
    options.CopyFrom(job.create)
    options.format = options.format or task.model_format
    options.label = options.label or task.label
    riders = Riders(options)
    calls = Calls(client._core._calls)
    where[0] = "model"
    info = calls.create(model.Upload(task.main, task.companions, task.model_format, task.label), options, _untold)
    here = calls.toward(info.id)
    try:
        if job.handles or any(job.HasField(name) for name in ("symmetry_plane", "region_of_interest", "stiff")):
            where[0] = "handles"
            request = pb.SetHandlesRequest(session_id=info.id, handles=job.handles)
            if job.HasField("symmetry_plane"):
                request.symmetry_plane.CopyFrom(job.symmetry_plane)
            if job.HasField("region_of_interest"):
                request.region_of_interest.CopyFrom(job.region_of_interest)
            if job.HasField("stiff"):
                request.stiff.CopyFrom(job.stiff)
            here.one("SetHandles", request, keyed=True)
        quality = None
        for k, step in enumerate(_steps(job)):
            if step.WhichOneof("step") == "edit" and step.edit.on == pb.EditRequest.CURRENT:
                where[0] = "create.passengers"
                riders.carry(here, info.id)
            where[0] = f"steps[{k}]"
            quality = _step(here, info.id, step, job)
        where[0] = "create.passengers"
        riders.carry(here, info.id)
        where[0] = "result"
        history = here.one("History", pb.SessionRequest(session_id=info.id))
        digest = next(commit.digest for commit in history.commits if commit.revision == history.current)
        exported = here.many("Export", pb.ExportRequest(session_id=info.id, format=task.format))
    finally:
        try:
            here.one("DeleteSession", pb.SessionRequest(session_id=info.id), patience=2.0)
        except errors.PliantError:
            pass  # it expires by itself
    files = {uri or f"model.{task.format}": data for uri, data in model.joined(exported).items()}
    where[0] = "create.passengers"
    for name, data in riders.files().items():
        if name in files:
            raise errors.InvalidArgument(f"{name!r} is to be written, which another file of the result has")
        files[name] = data
    return digest, quality, files, tuple(message.SerializeToString() for message in riders.told())


def _steps(job: pb.Job) -> list[pb.Step]:
    """The steps as ``pliant deform`` does them: without steps the poses that the handles come with are one."""
    if not job.steps and any(handle.HasField("pose") for handle in job.handles):
        return [pb.Step(pose=pb.Pose())]
    return [step for step in job.steps if step.WhichOneof("step") is not None]


def _step(calls: Any, session: str, step: pb.Step, job: pb.Job) -> bytes | None:
    """Does a step; answers the quality of a pose."""
    if step.WhichOneof("step") == "edit":
        request = pb.EditRequest()
        request.CopyFrom(step.edit)
        request.session_id = session
        calls.one("Edit", request, keyed=True)
        return None
    how = pb.Options()
    how.CopyFrom(job.options)
    how.ClearField("progressive")
    how.ClearField("window")
    # Of the frame nothing but its quality is of interest: what does not move need not travel.
    how.ClearField("output")
    expected = job.expect.HasField("new_self_intersections")
    how.output.self_intersections = job.options.output.self_intersections or expected
    parts = calls.many("Solve", pb.SolveRequest(session_id=session, pose=step.pose, options=how), keyed=True)
    for part in parts:
        if part.HasField("quality"):
            quality: bytes = part.quality.SerializeToString()
            return quality
    return None


def _untold(done: int, total: int) -> None:
    """Reports no upload."""


def _may_pass(error: errors.PliantError) -> bool:
    kinds = (errors.Unavailable, errors.LocalServerError, errors.ResourceExhausted, errors.Aborted, errors.SessionLost)
    return (isinstance(error, kinds) and not isinstance(error, errors.TooLarge)) or channel.is_lost(error)


def _name() -> str:
    return f"{socket.gethostname()}:{os.getpid()}"


_lock = threading.Lock()
_lines: dict[tuple[str | None, str, str], tuple[Client, str, LocalServer | None]] = {}


def _connected(place: Place) -> tuple[Client, str]:
    """This worker's connection, and the version of its server, which is started where there is none."""
    with _lock:
        known = (place.server, repr(place.keys), repr(place.way))
        if known in _lines:
            client, found, own = _lines[known]
            if own is None:
                # Who runs it may have put another version there.
                return client, version(place)
            if own.ended is None:
                return client, found
            client.close()
            del _lines[known]
        own = None if place.server is not None else LocalServer(**dict(place.keys))
        client = Client(own or place.server, **dict(place.way))
        found = version(Place(client.url, (), place.way))
        _lines[known] = (client, found, own)
        return client, found
