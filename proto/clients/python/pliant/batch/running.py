"""A batch under way."""

from __future__ import annotations

import dataclasses
import os
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from ..channel import Settings
from ..errors import LocalServerError
from ..progress import Meter, ProgressLike
from ..server import LocalServer
from ..values import number, seen, whole
from ..v1 import pliant_pb2 as pb
from .folder import ResultFolder
from .jobs import Job, Task, Unready, named, task
from .results import BatchReport, JobError, JobResult, judged
from .work import Outcome, Place, version
from .workers import ExecutorLike, Workers, default_count


def run(
    jobs: Iterable[Job],
    *,
    executor: ExecutorLike = None,
    results: str | os.PathLike[str] | None = None,
    resume: bool = True,
    workers: int | None = None,
    in_flight: int | None = None,
    retries: int = 2,
    start_timeout: float = 120.0,
    server: str | LocalServer | None = None,
    keys: Mapping[str, object] | None = None,
    way: Mapping[str, Any] | None = None,
    progress: ProgressLike = False,
) -> Batch:
    """Runs jobs, and answers an iterator of their results, in the order in which they are done.

    `executor` is any executor of ``concurrent.futures``, such as Dask's ``client.get_executor()`` or
    :class:`pliant.batch.RayExecutor`, or a function that makes one, which is called again where its processes died; absent, a
    pool of `workers` processes. Each worker starts a server of its own, configured by `keys`, or uses `server`; `way` is as in
    :func:`pliant.open`. `results` is a folder in which every job has one of its own; with `resume` a job whose result is there,
    made of the same model and job by the same version, is not run again. At most `in_flight` jobs are with the executor at a
    time. A job whose worker or server died is run again, `retries` times, the last time alone. `progress` is True for a bar,
    or a callable that is told how many jobs are done, of how many.

    Nothing runs before the first result is asked for; ``report()`` asks for all.
    """
    count = _count("workers", workers, default_count(), 1, 1_000)
    # A given executor does not tell how many workers it has.
    window = _count("in_flight", in_flight, 2 * count if executor is None else 8, 1, 10_000)
    if not 1 <= whole("retries", retries) <= 100:
        raise ValueError(f"retries: {seen(retries)}, 1 to 100 is allowed")
    if not 0 < number("start_timeout", start_timeout) <= 3600:
        raise ValueError(f"start_timeout: {seen(start_timeout)}, a number of seconds above 0 and up to 3600 is allowed")
    address = server.url if isinstance(server, LocalServer) else server or os.environ.get("PLIANT_SERVER") or None
    configured = dict(keys or {})
    if address is not None and configured:
        raise ValueError(
            "keys: they configure servers that workers start, and a server is named; one of the two is allowed"
        )
    if executor is None and address is None:
        # Not every worker's server takes every core.
        configured.setdefault("threads", max(1, (os.cpu_count() or 1) // count))
    Settings(address or "127.0.0.1", **(way or {}))  # refuses what is not allowed before anything starts
    place = Place(address, tuple(sorted(configured.items())), tuple(sorted((way or {}).items())))
    folder = None if results is None else ResultFolder(Path(results))
    every = named(jobs)
    return Batch(
        every, Workers(executor, count, place, start_timeout), place, folder, resume, window, retries, progress
    )


def _count(what: str, value: int | None, default: int, low: int, high: int) -> int:
    if value is None:
        return default
    if not low <= whole(what, value) <= high:
        raise ValueError(f"{what}: {seen(value)}, {low} to {high} is allowed")
    return int(value)


@dataclass
class _Ticket:
    """A job that has no result yet."""

    job: Job
    tries: int = 0
    lost: int = 0
    #: The executor that has it.
    generation: int = 0


class Batch(Iterator[JobResult]):
    """Results as they come. Made by :func:`run`. A ``with`` block, or :meth:`close`, ends the work with the wish for it."""

    def __init__(
        self,
        jobs: list[Job],
        workers: Workers,
        place: Place,
        folder: ResultFolder | None,
        resume: bool,
        window: int,
        retries: int,
        progress: ProgressLike,
    ) -> None:
        self._jobs = jobs
        self._workers = workers
        self._place = place
        self._folder = folder
        self._resume = resume
        self._window = window
        self._retries = retries
        self._progress = progress
        self._waiting = deque(_Ticket(job) for job in jobs)
        #: Those that lost their workers again and again: each runs alone, so that nothing else is blamed for it.
        self._alone: deque[_Ticket] = deque()
        self._running: dict[Future[Outcome], tuple[_Ticket, Task]] = {}
        self._ready: deque[JobResult] = deque()
        self._version: str | None = None
        self._told: list[JobResult] = []
        self._lost = 0
        self._each = self._run()

    def __next__(self) -> JobResult:
        return next(self._each)

    def report(self) -> BatchReport:
        """Waits for what is still to come, and reports all that came, in the order of the jobs."""
        for _ in self:
            pass
        order = {job.name: k for k, job in enumerate(self._jobs)}
        return BatchReport(tuple(sorted(self._told, key=lambda result: order[result.name])), self._lost)

    def close(self) -> None:
        """Gives up what is not done. Results that came are kept."""
        self._each.close()

    def __enter__(self) -> Batch:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self) -> Generator[JobResult, None, None]:
        finished = False
        try:
            with Meter(self._progress, "jobs") as tell:
                tell(0, len(self._jobs))
                while self._waiting or self._alone or self._running or self._ready:
                    self._fill()
                    if not self._ready and self._running:
                        for future in wait(self._running, return_when=FIRST_COMPLETED).done:
                            self._settle(future)
                    while self._ready:
                        result = self._ready.popleft()
                        self._told.append(result)
                        tell(len(self._told), len(self._jobs))
                        yield result
            finished = True
        finally:
            for future in self._running:
                future.cancel()
            self._workers.close(at_once=not finished)

    def _fill(self) -> None:
        """Hands jobs over while there is room, and until there is something to report."""
        while self._waiting and len(self._running) < self._window and not self._ready:
            self._begin(self._waiting.popleft())
        if not self._waiting and not self._running and self._alone:
            self._begin(self._alone.popleft())

    def _begin(self, ticket: _Ticket) -> None:
        name = ticket.job.name
        try:
            made = task(ticket.job, self._known_version())
        except Unready as problem:
            code = "NOT_FOUND" if problem.missing else "INVALID_ARGUMENT"
            self._fail(ticket, problem.where, code, str(problem))
            return
        if self._folder is not None and self._resume:
            before = self._folder.finished(name, made.key)
            if before is not None:
                self._ready.append(before)
                return
        try:
            future = self._workers.submit(made)
        except BrokenExecutor:
            self._workers.discard()
            self._retry(ticket, "its executor is broken")
            return
        except RuntimeError as refusal:
            self._fail(ticket, "executor", "FAILED_PRECONDITION", str(refusal))
            return
        ticket.tries += 1
        ticket.generation = self._workers.generation
        self._running[future] = (ticket, made)

    def _known_version(self) -> str:
        if self._version is None:
            try:
                self._version = version(self._place)
            except LocalServerError:
                # The program may be where the workers are, and not here.
                self._version = self._workers.asked_version()
        return self._version

    def _settle(self, future: Future[Outcome]) -> None:
        ticket, made = self._running.pop(future)
        try:
            outcome = future.result()
        except (Exception, CancelledError) as lost:
            # A worker answers failures; what is raised was raised by the way to it.
            if isinstance(lost, BrokenExecutor) and ticket.generation == self._workers.generation:
                self._workers.discard()
            self._retry(ticket, f"its worker was lost: {type(lost).__name__}: {lost}")
            return
        if outcome.failure is None:
            self._take(ticket, made, outcome)
            return
        where, code, words, field = outcome.failure
        if outcome.passing:
            self._retry(ticket, words, where=where, code=code)
        else:
            self._fail(ticket, where, code, words, field, outcome)

    def _retry(self, ticket: _Ticket, words: str, *, where: str = "worker", code: str = "UNAVAILABLE") -> None:
        self._lost += 1
        ticket.lost += 1
        if ticket.lost > self._retries:
            self._fail(ticket, where, code, f"{' '.join(words.split())} ({ticket.lost} tries, the last one alone)")
        elif ticket.lost == self._retries:
            self._alone.append(ticket)
        else:
            self._waiting.appendleft(ticket)

    def _fail(
        self,
        ticket: _Ticket,
        where: str,
        code: str,
        words: str,
        field: str | None = None,
        outcome: Outcome | None = None,
    ) -> None:
        error = JobError(ticket.job.name, where, words, code=code, field=field)
        worker, seconds = (outcome.worker, outcome.seconds) if outcome is not None else ("", 0.0)
        self._ready.append(JobResult(ticket.job.name, tries=ticket.tries, worker=worker, seconds=seconds, error=error))

    def _take(self, ticket: _Ticket, made: Task, outcome: Outcome) -> None:
        quality = None if outcome.quality is None else pb.Quality.FromString(outcome.quality)
        broken, unchecked = judged(pb.Job.FromString(made.job), outcome.digest, quality)
        result = JobResult(
            made.name,
            made.key,
            outcome.digest,
            quality,
            broken,
            unchecked,
            tuple(pb.Report.Passenger.FromString(passenger) for passenger in outcome.passengers),
            tries=ticket.tries,
            seconds=outcome.seconds,
            worker=outcome.worker,
        )
        if self._folder is None:
            self._ready.append(dataclasses.replace(result, files=outcome.files))
            return
        try:
            paths = self._folder.keep(result, outcome.files)
        except (OSError, ValueError) as problem:
            self._fail(ticket, "results", "FAILED_PRECONDITION", str(problem), None, outcome)
            return
        self._ready.append(dataclasses.replace(result, paths=paths))
