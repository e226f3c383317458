"""Running a sweep, resumable after any interruption."""

import time
from collections.abc import Generator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import NamedTuple, cast

from ..scene.progress import Progress, duration_text
from ..simulation.agents.registry import agent_code, agent_file
from ..simulation.interop.hugsim_agent import missing_client_files
from ..trusted_code import Code, check_trusted, command_code
from .executors import Executor, LocalPool
from .expansion import DriveJob, Job, jobs_of
from .report import SweepReport, write_tables
from .results import SweepFolder
from .settings import Sweep
from .worker import JobResult, run_job


class SweepRun(NamedTuple):
    """Counts of a sweep run."""

    done: int  # jobs that got a row in this run, including failed ones
    failed: int


def run_sweep(jobs: Sequence[Job], engine: Executor, folder: SweepFolder) -> Generator[Progress, None, SweepRun]:
    """Run jobs and write each row as it arrives; yields progress after each, with its time and the time left.

    The time left is that of this run so far, for each of the other jobs. Closing the generator, or an error, stops
    running jobs; written rows stay.

    Raises:
        UntrustedCodeError: Before anything runs, if an agent's Python file is not trusted.
        OSError: If a row can't be written, or a worker reports that no further job can succeed.
    """
    by_id = {job.id: job for job in jobs}
    done = failed = 0
    began_s = time.monotonic()
    if not jobs:
        return SweepRun(0, 0)
    codes = agent_codes(jobs)
    check_trusted(folder.path, codes)
    yield Progress(0.0, "Starting workers")
    work = partial(
        run_job, clips=folder.clips.absolute(), trusted=tuple(each.digest for each in codes),
        clients=folder.clients.absolute(),
    )  # fmt: skip
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
            result = outcome.values.get("end") if outcome.error is None else outcome.error
            took = f" ({duration_text(outcome.seconds)})" if outcome.seconds else ""
            left_s = (time.monotonic() - began_s) / done * (len(jobs) - done)
            left = f"; {duration_text(left_s)} left" if done < len(jobs) else ""
            yield Progress(
                done / len(jobs), f"{counted}: {job.title}" + (f": {result}" if result else "") + took + left
            )
    return SweepRun(done, failed)


def agent_codes(jobs: Sequence[Job]) -> list[Code]:
    """Python files and commands that jobs use as agents, without duplicates; raises ValueError for a missing file."""
    agents = [job.agent for job in jobs if isinstance(job, DriveJob)]
    files = {path for agent in agents if (path := agent_file(agent.name)) is not None}
    commands = {agent.hugsim.command for agent in agents if agent.hugsim is not None}
    return [*map(agent_code, sorted(files, key=str)), *map(command_code, sorted(commands))]


def missing_clients(jobs: Sequence[Job]) -> list[str]:
    """Name the programs and scripts of HUGSIM clients that this machine lacks; a line each.

    Raises ClientError for a command that can't be read.
    """
    agents = [job.agent.hugsim for job in jobs if isinstance(job, DriveJob)]
    commands = dict.fromkeys(each.command for each in agents if each is not None)
    return [line for command in commands for line in missing_client_files(command)]


def _stopped(folder: SweepFolder, reason: str, done: int) -> str:
    return f"{folder.path}: stopped after {done} rows: {reason}; what was written is whole, run it again to go on"


def run_sweep_and_report(
    sweep: Sweep, folder: Path, engine: Executor | None = None
) -> Generator[Progress, None, SweepReport]:
    """Run the missing jobs of a sweep and write tables, figures and report; yields progress after each job.

    Existing rows are kept, so a stopped or extended sweep continues. Without `engine`, half of the cores are used.

    Raises:
        ValueError: If the settings give no valid jobs; `UntrustedCodeError` for agents in Python files that are not
            trusted (`trusted_code.remember` trusts them).
        OSError: If a row can't be written.
    """
    target, jobs = SweepFolder(folder), jobs_of(sweep)
    target.describe(sweep, jobs)
    yield from run_sweep(target.to_do(jobs), engine or LocalPool(), target)
    return write_tables(target, sweep, jobs)
