"""A sweep from its jobs to its rows: what is done stays done, wherever it is stopped."""

from collections.abc import Generator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeGuard, cast

from ..scene.progress import Progress
from ..simulation.agents.registry import agent_code, agent_file
from ..trusted_code import Code, check_trusted
from .executors import Executor, LocalPool
from .expansion import DriveJob, Job, jobs_of
from .report import write_tables
from .results import SweepFolder
from .settings import Sweep
from .worker import JobResult, run_job


class SweepRun(NamedTuple):
    """What a run of a sweep has done."""

    done: int
    """Jobs that have got a row now, failed ones among them."""
    failed: int
    """Of these."""


def run_sweep(jobs: Sequence[Job], engine: Executor, folder: SweepFolder) -> Generator[Progress, None, SweepRun]:
    """Do jobs and write a row for each, as it comes; yields after each.

    Closing the generator, or an error, stops what is under way; every row that was written stays.

    Raises:
        UntrustedCodeError: Before anything runs, for agents' Python files that no person has allowed.
        OSError: When a row can't be written, or a worker says that nothing can be.
    """
    by_id = {job.id: job for job in jobs}
    done = failed = 0
    if not jobs:
        return SweepRun(0, 0)
    codes = agent_codes(jobs)
    check_trusted(folder.path, codes)
    yield Progress(0.0, "Starting workers")
    work = partial(run_job, clips=folder.clips.absolute(), trusted=tuple(each.digest for each in codes))
    outcomes = cast(Generator[JobResult], engine.outcomes(work, jobs))
    with closing(outcomes):
        for outcome in outcomes:
            job = by_id[outcome.id]
            if outcome.stops:
                raise OSError(_stopped(folder, outcome.error or "", done))
            try:
                folder.keep(job, outcome)
            except OSError as error:
                raise OSError(_stopped(folder, error.strerror or str(error), done)) from error
            done, failed = done + 1, failed + (outcome.error is not None)
            counted = f"{done} of {len(jobs)}" + (f", {failed} failed" if failed else "")
            yield Progress(done / len(jobs), f"{counted}: {_described(job, outcome)}")
    return SweepRun(done, failed)


def agent_codes(jobs: Sequence[Job]) -> list[Code]:
    """Read the Python files that jobs name as agents, each once; raises ValueError where one is not there."""
    names = {job.agent.name.rpartition(".py")[0] + ".py" for job in jobs if _has_own_agent(job)}
    return [code for name in sorted(names) if (code := agent_code(name)) is not None]


def _has_own_agent(job: Job) -> TypeGuard[DriveJob]:
    return isinstance(job, DriveJob) and agent_file(job.agent.name) is not None


def _described(job: Job, outcome: JobResult) -> str:
    if outcome.error is not None:
        return f"{job.title}: {outcome.error}"
    end = outcome.values.get("end")
    return f"{job.title}: {end}" if end else job.title


def _stopped(folder: SweepFolder, reason: str, done: int) -> str:
    return f"{folder.path}: stopped after {done} rows: {reason}; what was written is whole, run it again to go on"


# § A sweep from its settings to its tables, in one call.


def run_sweep_and_report(
    sweep: Sweep, folder: Path, engine: Executor | None = None
) -> Generator[Progress, None, dict[str, Any]]:
    """Do what a sweep still lacks in a folder, and write its tables, figures and report; yields after each job.

    Rows that stand there are kept: stopped or extended, it goes on. Without an engine, half of this machine's cores
    work.

    Returns:
        The numbers of `summary.json`.

    Raises:
        ValueError: For settings of which there are no jobs, and `UntrustedCodeError` for agents in Python files that
            no person has allowed: `trusted_code.remember` allows them.
        OSError: When a row can't be written.
    """
    kept, jobs = SweepFolder(folder), jobs_of(sweep)
    kept.describe(sweep, jobs)
    yield from run_sweep(kept.to_do(jobs), engine or LocalPool(), kept)
    return write_tables(kept, sweep, jobs)
