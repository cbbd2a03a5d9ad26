"""What rides along with a job's model and is not a part of it: points, and other models.

A session holds none of them, so that the worker carries them by calls, whenever an edit makes the current shape the rest pose
and in the end, as ``pliant deform`` does.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any

from ..v1 import pliant_pb2 as pb

#: How a glTF in one file and a PLY begin; other formats cannot be recognised for certain.
_MAGIC = {b"glTF": "glb", b"ply\n": "ply", b"ply\r": "ply"}
_KINDS = ("points", "file")


def refusal(job: pb.Job, format: str) -> tuple[str, str] | None:
    """What of a job's riders a batch cannot do: where, and why; `format` is what the result is written as."""
    taken = {"result.json", f"model.{format}"}
    for where, file in _files(job.create):
        path = PurePosixPath(file.output)
        parts = file.output.split("/")
        if any(part in ("", ".", "..") for part in parts) or any(letter in file.output for letter in "\\:\0"):
            return where, f"is {file.output!r}, a path of plain names is allowed, such as 'hull.obj'"
        if file.output in taken:
            return where, f"is {file.output!r}, which another file of the result has"
        taken.add(file.output)
        own = (file.format or _MAGIC.get(file.model[:4], "")).lower()
        if path.suffix[1:].lower() != own:
            told = f"its own format, {own}" if own else "the format that `format` names"
            return where, f"is {file.output!r}, but a batch writes what rides along in {told}"
    return None


def _files(create: pb.CreateOptions) -> Iterator[tuple[str, Any]]:
    for k, passenger in enumerate(create.passengers):
        if passenger.WhichOneof("passenger") == "file":
            yield f"create.passengers[{k}].file.output", passenger.file


class Riders:
    """The riders of one job, as they are in the rest pose that is in force."""

    def __init__(self, options: pb.CreateOptions) -> None:
        """Takes them out of what a session is created with."""
        every = list(options.passengers)
        del options.passengers[:]
        options.passengers.extend(p for p in every if p.WhichOneof("passenger") not in _KINDS)
        self._riders = [_Rider(p) for p in every if p.WhichOneof("passenger") in _KINDS]

    def carry(self, calls: Any, session: str) -> None:
        """Carries all along with the current shape."""
        for rider in self._riders:
            rider.carry(calls, session)

    def files(self) -> dict[str, bytes]:
        """The models, by the paths that they are written to."""
        return {rider.message.output: rider.file.model for rider in self._riders if rider.message.output}

    def told(self) -> list[pb.Report.Passenger]:
        """The reports of all, in the order of the job."""
        return [rider.message for rider in self._riders]


class _Rider:
    def __init__(self, passenger: pb.Passenger) -> None:
        self.file = pb.Passenger.File()
        self.message = pb.Report.Passenger(name=passenger.name)
        if passenger.WhichOneof("passenger") == "file":
            self.file.CopyFrom(passenger.file)
            self.message.output = passenger.file.output
        else:
            self.message.positions.extend(passenger.points.positions)
            self.message.rotations.extend(passenger.points.rotations)

    def carry(self, calls: Any, session: str) -> None:
        if self.message.output:
            request = pb.CarryRequest(session_id=session, model=self.file.model, format=self.file.format)
            self.file.model = calls.one("Carry", request).model
            return
        before = self.message
        request = pb.CarryRequest(session_id=session, points=before.positions, rotations=before.rotations)
        answer = calls.one("Carry", request)
        scales = before.scales or [1.0] * len(answer.scales)
        now = pb.Report.Passenger(name=before.name, positions=answer.points, rotations=answer.rotations)
        now.scales.extend(then * more for then, more in zip(scales, answer.scales))
        self.message = now
