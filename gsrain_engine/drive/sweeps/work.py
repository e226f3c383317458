"""What a worker does with a job, wherever it runs: it answers, whatever happens."""

import errno
import os
import platform
import threading
import time
from collections.abc import Collection
from pathlib import Path

from msgspec import structs

from gsrain_engine.scene.trusted_code import UntrustedCodeError, trust

from .drive_work import do_drive
from .job import DriveJob, Job
from .outcome import Outcome
from .program import program_version, software
from .render_work import do_render
from .workbench import MismatchError, workbench

_FULL = {errno.ENOSPC, errno.EDQUOT}

_ONE_AT_A_TIME = threading.Lock()
"""Compiled kernels use all threads of a process: two jobs in one would only wait for each other."""


def do(job: Job, clips: Path, trusted: Collection[str] = ()) -> Outcome:
    """Do a job; what it raises becomes the outcome's error.

    `clips` is where clips go; `trusted` are digests of the agents' code that a person has allowed.
    """
    started = time.perf_counter()
    with _ONE_AT_A_TIME:
        try:
            trust(trusted)
            _check_program(job)
            bench = workbench()
            bench.check_files(job.files)
            outcome = do_drive(job, bench) if isinstance(job, DriveJob) else do_render(job, bench, clips)
        except Exception as error:
            stops = isinstance(error, MismatchError | UntrustedCodeError) or _is_full(error)
            outcome = Outcome(id=job.id, error=_sentence(error), stops=stops)
    values = {**outcome.values, "software": ", ".join(f"{name} {each}" for name, each in software().items())}
    return structs.replace(
        outcome, values=values, seconds=time.perf_counter() - started, worker=f"{platform.node()} {os.getpid()}"
    )


def _check_program(job: Job) -> None:
    here = program_version()
    if job.program != here:
        raise MismatchError(f"a worker runs gsrain {here}, the sweep was made by gsrain {job.program}")


def _sentence(error: Exception) -> str:
    said = " ".join(str(error).split()) or type(error).__name__
    return said if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: {said}"


def _is_full(error: BaseException | None) -> bool:
    while error is not None:
        if isinstance(error, OSError) and error.errno in _FULL:
            return True
        error = error.__cause__
    return False
