"""What became of jobs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import PliantError
from ..v1 import pliant_pb2 as pb

#: Failures that a message lists.
_LISTED = 5


class JobError(PliantError):
    """Why one job has no result: ``job`` names it, ``where`` the part of it that is to blame, such as ``steps[2]``."""

    def __init__(self, job: str, where: str, message: str, *, code: str, field: str | None = None) -> None:
        place = f"{where}: {field}" if field and field not in message else where
        super().__init__(f"{job}: {place}: {message}", code=code, field=field)
        self.job = job
        self.where = where


class BatchFailed(PliantError):
    """Some jobs of a batch have no result, or one that is not as expected; ``report`` lists all."""

    code = "ABORTED"

    def __init__(self, message: str, report: BatchReport) -> None:
        super().__init__(message)
        self.report = report


@dataclass(frozen=True)
class JobResult:
    """What became of one job."""

    name: str
    #: Digest of what went in: model, job, format and version.
    key: str = ""
    #: Digest of the final positions, as ``pliant deform --json`` prints it.
    digest: str = ""
    #: Of the last pose, against the rest shape; absent where the last step is none.
    quality: pb.Quality | None = None
    #: Expectations of the job that do not hold, one sentence each.
    unmet: tuple[str, ...] = ()
    #: Expectations that were not checked, and why.
    unchecked: tuple[str, ...] = ()
    #: Where points ended that rode along, and which files were written of other models; in the order of ``create.passengers``.
    passengers: tuple[pb.Report.Passenger, ...] = ()
    #: The files written, the model first; empty without a folder for results.
    paths: tuple[Path, ...] = ()
    #: The files by name, where no folder for results was given; the model is ``model.FORMAT``.
    files: Mapping[str, bytes] = field(default_factory=dict, repr=False)
    #: Whether an earlier run had made it.
    resumed: bool = False
    #: How often it was given to a worker.
    tries: int = 0
    #: Seconds that the worker took.
    seconds: float = 0.0
    #: ``HOST:PID`` of the worker that made it.
    worker: str = ""
    #: Why there is no result.
    error: JobError | None = None

    @property
    def ok(self) -> bool:
        """Whether there is a result and it is as the job expects."""
        return self.error is None and not self.unmet

    def __str__(self) -> str:
        if self.error is not None:
            return str(self.error)
        return f"{self.name}: {'; '.join(self.unmet) or self.digest}"


@dataclass(frozen=True)
class BatchReport:
    """What became of all jobs, in the order in which they were given."""

    results: tuple[JobResult, ...]
    #: Tries that ended with their worker, all jobs together.
    lost: int

    @property
    def ok(self) -> bool:
        """Whether every job has a result that is as expected."""
        return all(result.ok for result in self.results)

    @property
    def failed(self) -> tuple[JobResult, ...]:
        """The jobs without a result, or with one that is not as expected."""
        return tuple(result for result in self.results if not result.ok)

    @property
    def resumed(self) -> int:
        """How many jobs an earlier run had finished."""
        return sum(result.resumed for result in self.results)

    @property
    def digests(self) -> dict[str, str]:
        """The digests of all results, by name."""
        return {result.name: result.digest for result in self.results if result.error is None}

    def check(self) -> BatchReport:
        """Answers itself where all is well, else raises :class:`BatchFailed`."""
        failed = self.failed
        if failed:
            listed = "; ".join(str(result) for result in failed[:_LISTED])
            more = f"; and {len(failed) - _LISTED} more" if len(failed) > _LISTED else ""
            raise BatchFailed(f"{len(failed)} of {len(self.results)} jobs failed: {listed}{more}", self)
        return self

    def __getitem__(self, name: str) -> JobResult:
        for result in self.results:
            if result.name == name:
                return result
        raise KeyError(name)

    def __iter__(self) -> Iterator[JobResult]:
        return iter(self.results)

    def __len__(self) -> int:
        return len(self.results)

    def __str__(self) -> str:
        lines = [
            f"{len(self.results)} jobs, {self.resumed} finished before, {len(self.failed)} failed, {self.lost} tries lost"
        ]
        return "\n".join(lines + [f"  {result}" for result in self.failed])


def judged(job: pb.Job, digest: str, quality: pb.Quality | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What the job expects and does not hold, and what was not checked."""
    expect = job.expect
    broken, unchecked = [], []
    stored = {"maxDistance": "max_distance", "meanDistance": "mean_distance", "normalDegrees": "normal_degrees"}
    for name, asked in stored.items():
        if expect.HasField(asked):
            unchecked.append(f"{name} needs a stored result")
    measured = {
        "flippedTriangles": "flipped_triangles",
        "newSelfIntersections": "new_self_intersections",
        "volumeChange": "volume_change",
    }
    for name, asked in measured.items():
        if not expect.HasField(asked):
            continue
        most = getattr(expect, asked)
        if quality is None:
            unchecked.append(f"{name} needs a last step that is a pose")
        elif abs(getattr(quality, asked)) > most:
            broken.append(f"{name} is {getattr(quality, asked)!r}, at most {most!r} expected")
    if expect.digest and expect.digest != digest:
        broken.append(f"digest is {digest}, expected {expect.digest}")
    return tuple(broken), tuple(unchecked)
