"""Many jobs, each a model and what is done with it, on any executor of :mod:`concurrent.futures`.

    import pliant.batch

    if __name__ == "__main__":  # workers import this file again
        jobs = [pliant.batch.Job(path.stem, path, "bend.json") for path in models]
        report = pliant.batch.run(jobs, results="bent", progress=True).report()
        print(report)

Every worker starts a server of its own, or uses the one that ``server=`` names. Results come as they are done; a worker that
dies costs nothing but time; an interrupted batch continues where it was.
"""

from .jobs import Job
from .on_ray import RayExecutor
from .results import BatchFailed, BatchReport, JobError, JobResult
from .running import Batch, run
from .workers import WorkersLost

__all__ = [
    "Batch",
    "BatchFailed",
    "BatchReport",
    "Job",
    "JobError",
    "JobResult",
    "RayExecutor",
    "WorkersLost",
    "run",
]
