"""`gsrain sweep SWEEP.yaml`: many drives or renders, locally, in shards, or on a cluster."""

import shlex
import signal
import sys
import time
from collections.abc import Generator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec

from gsrain_engine.safe_io.errors import MissingInputsError
from gsrain_engine.sweep.settings import DriveSweep, Sweep, load_sweep, sweep_names
from gsrain_engine.trusted_code import check_trusted

from .console import counted, print, print_lines, run_with_progress
from .options import (
    JsonFile,
    StructOptions,
    Trust,
    check_within,
    converted_options,
    flag,
    option,
    options_of,
    split_words,
    takes_set,
    with_trust,
)
from .outputs import check_writable, lock_outputs, write_numbers

if TYPE_CHECKING:
    from gsrain_engine.report.table import Table
    from gsrain_engine.sweep.executors import Executor
    from gsrain_engine.sweep.expansion import Job
    from gsrain_engine.sweep.results import SweepFolder
    from gsrain_engine.sweep.run import SweepRun


SOME_FAILED, INTERRUPTED = 1, 130
SweepOptions = options_of(
    DriveSweep, "sweep", "Default: the sweep's.", topic="Options"
)  # those of a `RenderSweep` are the same


@takes_set
def sweep(
    sweep: Annotated[str, option(f"YAML file, or a shipped sweep: {', '.join(sweep_names())}.")],
    /,
    *,
    options: SweepOptions | None = None,
    workers: Annotated[int | None, option("Processes; default: half of the cores; 0: this process.")] = None,
    shard: Annotated[str | None, option("Run only share i of n, as i/n from 1, such as 1/8.")] = None,
    dask: Annotated[str | None, option("Run on a Dask cluster: address of its scheduler.")] = None,
    dask_resources: Annotated[str, option("Resources that a job needs, as NAME=AMOUNT, with commas: GPU=1.")] = "",
    retry_failed: Annotated[bool, flag("Repeat jobs that have failed.")] = False,
    summarize_only: Annotated[bool, flag("Run nothing; write tables and figures of existing rows.")] = False,
    trust: Trust = False,
    json: JsonFile = None,
) -> int:
    """Run every combination that a sweep names. Run again, it resumes: jobs with a row are not repeated.

    Any number of such commands may work on one folder, with --shard on independent machines. Rows contain neither times
    nor machine names; equal jobs give byte-identical rows. The row of a failed job has the error. Agents in Python
    files run only with --trust, or once you have allowed their content in a terminal. Into pipes and files, progress is
    a line per finished job.
    """
    from gsrain_engine.sweep.expansion import Shard, jobs_of
    from gsrain_engine.sweep.report import write_tables
    from gsrain_engine.sweep.run import SweepRun, agent_codes, missing_clients

    started = time.perf_counter()
    settings, folder = _settings(sweep, options or SweepOptions())
    resources = _check_engine(workers, dask, dask_resources)
    check_writable(folder.path / "table.csv", folder.path / "report.html", json, folders=[folder.path])
    jobs = jobs_of(settings)
    share = jobs if shard is None else Shard.parse(shard).of(jobs)
    to_do = [] if summarize_only else folder.to_do(share, retry_failed=retry_failed)
    run = SweepRun(0, 0)
    lock_outputs(folder.path, shared=True)
    if not summarize_only:
        if dask is None and (missing := missing_clients(to_do)):  # the workers of a cluster have files of their own
            raise MissingInputsError(missing)
        with_trust(lambda: check_trusted(sweep, agent_codes(to_do)), trust)
        folder.describe(settings, jobs)
        print(f"{folder.path}: {counted(len(share), 'job')}, {len(share) - len(to_do)} with a row", file=sys.stderr)
        with ExitStack() as stack:
            ran = _run(to_do, _engine(workers, dask, resources, stack), folder, stack)
        if ran is None:
            left = counted(len(folder.to_do(share)), "job")
            print(f"stopped with {left} to do; the same command goes on from there", file=sys.stderr)
            return INTERRUPTED
        run = ran
    numbers: dict[str, Any] = {"done": run.done, "kept": len(share) - len(to_do)}
    failed = run.failed
    if shard is not None and folder.to_do(jobs):
        summarize = shlex.join(["gsrain", "sweep", sweep, "-o", str(folder.path), "--summarize-only"])
        print(f"share {shard} is done; when all are: {summarize}")
    else:
        report = write_tables(folder, settings, jobs)
        numbers |= report.numbers
        failed = numbers["failed"]
        _print(folder, numbers, report.tables)
    write_numbers(json, numbers | {"seconds": time.perf_counter() - started})
    return SOME_FAILED if failed else 0


def _settings(name: str, options: StructOptions) -> "tuple[Sweep, SweepFolder]":
    """Return a sweep with the options, and its folder; raises ValueError for options that it does not have."""
    from gsrain_engine.sweep.results import SweepFolder

    chosen = options.changes()
    output, loaded = chosen.pop("output", None), load_sweep(name)
    if wrong := [each for each in chosen if each not in loaded.__struct_fields__]:
        raise ValueError(f"--{wrong[0].replace('_', '-')}: sweep {name} makes clips; only drives have it")
    settings = converted_options(msgspec.to_builtins(loaded) | chosen, type(loaded))
    if output is None and settings.output is None:
        raise ValueError(f"sweep {name}: expected --output DIR, for it has no `output` of its own")
    return settings, SweepFolder(Path(str(output or settings.output)))


def _run(jobs: "Sequence[Job]", engine: "Executor", folder: "SweepFolder", stack: ExitStack) -> "SweepRun | None":
    """Run jobs, with a line for each; returns None if somebody stops them."""
    from gsrain_engine.sweep.run import run_sweep

    try:
        stack.enter_context(_sigterm_as_ctrl_c())
        work = stack.enter_context(closing(run_sweep(jobs, engine, folder)))
        return run_with_progress(work, line_every_s=0)
    except KeyboardInterrupt:
        return None


def _check_engine(workers: int | None, dask: str | None, resources: str) -> dict[str, float]:
    """Raise ValueError for options that contradict each other, before anything is written; returns the resources."""
    if dask is None and resources:
        raise ValueError(f"--dask-resources {resources}: expected --dask ADDRESS with it")
    if dask is not None and workers is not None:
        raise ValueError("--workers and --dask exclude each other: a cluster has as many as it has")
    check_within("--workers", workers, 0, 4096)
    try:
        return {name: float(amount) for name, _, amount in (word.partition("=") for word in split_words(resources))}
    except ValueError:
        raise ValueError(f"--dask-resources {resources}: expected NAME=AMOUNT, such as GPU=1") from None


def _engine(workers: int | None, dask: str | None, resources: dict[str, float], stack: ExitStack) -> "Executor":
    from gsrain_engine.sweep.executors import DaskCluster, LocalPool, SerialExecutor

    if dask is None:
        return SerialExecutor() if workers == 0 else LocalPool(workers)
    cluster = DaskCluster(dask, resources)
    stack.callback(cluster.close)
    if cluster.workers == 0:
        print(f"{dask} has no workers yet: waiting for some", file=sys.stderr)
    return cluster


@contextmanager
def _sigterm_as_ctrl_c() -> Generator[None]:
    """Treat SIGTERM, which batch systems send at their time limit, as Ctrl-C."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _print(folder: "SweepFolder", numbers: dict[str, Any], tables: "Sequence[Table]") -> None:
    for table in tables:
        print(f"{table.title}:")
        print_lines(f"{table.text}\n")
    done = numbers["rows"] - numbers["failed"]
    print(f"{folder.path}: {done} of {counted(numbers['jobs'], 'job')} finished, {numbers['failed']} failed")
    for error, count in numbers["errors"].items():
        print(f"  {count} x {error}")
    if numbers["failed"] and folder.clients.is_dir():
        print(f"{folder.clients}: the output of each client, a file named by its job")
    further = ", figures" if numbers["cells"] else ""
    further += ", attribution.png, attribution.csv, attribution_drives.csv" if numbers.get("attribution") else ""
    print(f"wrote table.parquet, table.csv, summary.json, report.html{further}")
