"""A sweep from its settings to its tables, in one call."""

from collections.abc import Generator
from pathlib import Path
from typing import Any

from gsrain_engine.scene.progress import Progress

from .engine import Engine
from .expansion import jobs_of
from .local_pool import LocalPool
from .run import run_sweep
from .sweep import Sweep
from .sweep_folder import SweepFolder
from .table import write_tables


def finish_sweep(sweep: Sweep, folder: Path, engine: Engine | None = None) -> Generator[Progress, None, dict[str, Any]]:
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
