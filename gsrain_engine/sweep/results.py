"""Result rows of a sweep, their summary with confidence intervals, and the sweep folder.

Rows depend only on the job: they hold neither times nor machine names.
"""

import errno
import io
import os
import time
from collections.abc import Iterable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from msgspec import Struct, inspect

from ..optional_packages import import_package
from ..report.interval import Interval
from ..safe_io.files import whole_file
from ..safe_io.limits import read_file
from ..safe_io.text_files import printable_line
from ..simulation.metrics.summary import RESULT_COLUMNS, DriveMetrics, is_measured, mean_of
from ..simulation.rollout_io import write_rollout
from .expansion import Job
from .settings import Sweep, Variant
from .worker import JobResult, Value

Row = dict[str, Value]
_MAX_ROWS = 10_000_000  # limit per file; the file of one job has one row
FINISHED, FAILED = "finished", "failed"

_SHARED: dict[str, type] = {
    "id": str, "kind": str, "status": str, "error": str, "scene": str, "scene_hash": str, "intensity_mm_h": float,
    "seed": int, "backend": str, "program": str, "software": str,
}  # fmt: skip

_DRIVE: dict[str, type] = {
    **_SHARED, "scenario": str, "agent": str, "agent_name": str, "wet": bool, "preset": str, "sensor": str,
    "mirror": bool, "splashes": bool, "spray": bool, "friction": str, "exposure_s": float, "diameter_scale": float,
    "start_speed_m_s": float, "gap_m": float,
}  # fmt: skip

_RENDER: dict[str, type] = {
    **_SHARED, "sensor": str, "labels": str, "clip": str, "clip_hash": str, "cameras": int, "frames": int,
    "sizes_px": str, "implied_mm_h": float, "drops": int,
}  # fmt: skip

_TYPES: dict[type, type] = {
    inspect.BoolType: bool, inspect.IntType: int, inspect.FloatType: float, inspect.StrType: str
}  # fmt: skip


def columns_of(kind: str) -> dict[str, type]:
    """Return names and types of the columns of "drive" or "render" rows in order; all but the first may be None.

    Measured columns of drives are the fields of `DriveMetrics`.
    """
    if kind == "render":
        return _RENDER
    columns = dict(_DRIVE)
    for field in inspect.type_info(DriveMetrics).fields:  # pyright: ignore[reportAttributeAccessIssue]: that of a struct
        choices = field.type.types if isinstance(field.type, inspect.UnionType) else (field.type,)
        columns.setdefault(field.name, next(_TYPES[type(each)] for each in choices if type(each) in _TYPES))
    return columns


def row_of(job: Job, outcome: JobResult) -> Row:
    """Merge job parameters and results into a row; parameters take precedence."""
    status = FINISHED if outcome.error is None else FAILED
    values: dict[str, Any] = {**outcome.values, **job.parameters, "status": status, "error": outcome.error}
    return {name: values.get(name) for name in columns_of(values["kind"])}


def rows_parquet(rows: Sequence[Row], kind: str) -> bytes:
    """Return rows as the bytes of a Parquet file; the same rows give the same bytes."""
    arrow, files = parquet_modules()
    types = {str: arrow.string(), int: arrow.int64(), float: arrow.float64(), bool: arrow.bool_()}
    schema = arrow.schema([(name, types[each]) for name, each in columns_of(kind).items()])
    table = arrow.Table.from_pylist(list(rows), schema=schema)
    sink = io.BytesIO()
    files.write_table(table, sink, compression="zstd", use_dictionary=False, write_statistics=False)
    return sink.getvalue()


def rows_in(data: bytes) -> list[Row]:
    """Read rows from the bytes of a Parquet file. Raises ValueError for anything else."""
    arrow, files = parquet_modules()
    try:
        with files.ParquetFile(io.BytesIO(data)) as file:
            if file.metadata.num_rows > _MAX_ROWS:
                raise ValueError(f"{file.metadata.num_rows} rows")
            return file.read().to_pylist()
    except (arrow.ArrowException, OSError, OverflowError, ValueError) as error:  # any of these for damaged files
        raise ValueError(f"no Parquet file: {printable_line(error)}") from None


def parquet_modules() -> tuple[Any, Any]:
    """Import pyarrow and its Parquet module on first use."""
    return import_package("pyarrow", "a table of a sweep"), import_module("pyarrow.parquet")


def indented_json(value: Any) -> bytes:
    return msgspec.json.format(msgspec.json.encode(value), indent=1) + b"\n"


# Summary

MEASURED = (*RESULT_COLUMNS, "planned_frame_collision_rate", "route_completion")
"""Summarized columns."""


class SummaryCell(Struct, frozen=True, kw_only=True):
    """All seeds of one group at one intensity."""

    scene: str
    scenario: str
    agent: str
    variant: Variant = Variant()
    intensity_mm_h: float
    runs: int  # number of finished runs, without failed ones
    failed: int
    collisions: int
    collision_rate: Interval | None  # share of the runs with a collision, with Wilson's interval (Wilson 1927)
    means: dict[str, Interval]
    """Means over the seeds of the columns in `MEASURED`, with bootstrap intervals; columns without values are left out.
    C and S are those of drives without a collision."""
    changes: dict[str, Interval]
    """Like `means`, for paired differences from the lowest intensity with the same seed: the effect of rain."""

    @property
    def title(self) -> str:
        """Agent, and the choices on further axes, as curves and tables name them."""
        return ", ".join(filter(None, [self.agent, self.variant.title]))


def summarized(rows: Iterable[Row]) -> list[SummaryCell]:
    """Summarize the rows of drives, sorted by parameters."""
    ordered = sorted(rows, key=_place)
    cells: list[SummaryCell] = []
    for group in dict.fromkeys(map(_group, ordered)):
        own = [row for row in ordered if _group(row) == group]
        intensities = list(dict.fromkeys(_number(row["intensity_mm_h"]) for row in own))
        at = {each: [row for row in own if row["intensity_mm_h"] == each] for each in intensities}
        cells += [_summary_cell(group, each, at[each], at[intensities[0]]) for each in intensities]
    return cells


def by_scenario(cells: Iterable[SummaryCell]) -> list[list[SummaryCell]]:
    """Group cells by scene and scenario, in order."""
    cells = list(cells)
    places = list(dict.fromkeys((cell.scene, cell.scenario) for cell in cells))
    return [[cell for cell in cells if (cell.scene, cell.scenario) == place] for place in places]


def _summary_cell(group: "_Group", intensity: float, rows: Sequence[Row], lowest: Sequence[Row]) -> SummaryCell:
    finished = [row for row in rows if row["status"] == FINISHED]
    collisions = sum(bool(row["collision"]) for row in finished)
    means = {name: mean_of(name, finished) for name in MEASURED}
    before = {row["seed"]: row for row in lowest if row["status"] == FINISHED and rows is not lowest}
    pairs = [(row, before[row["seed"]]) for row in finished if row["seed"] in before]
    changes: dict[str, Interval | None] = {}
    for name in MEASURED:
        known = [pair for pair in pairs if all(is_measured(name, row) for row in pair)]
        differences = [_number(now[name]) - _number(dry[name]) for now, dry in known]
        changes[name] = Interval.bootstrap(differences, "pairs") if differences else None
    return SummaryCell(
        scene=group.scene,
        scenario=group.scenario,
        agent=group.agent,
        variant=group.variant,
        intensity_mm_h=intensity,
        runs=len(finished),
        failed=len(rows) - len(finished),
        collisions=collisions,
        collision_rate=Interval.wilson(collisions, len(finished), "drives") if finished else None,
        means={name: each for name, each in means.items() if each is not None},
        changes={name: each for name, each in changes.items() if each is not None},
    )


class _Group(NamedTuple):
    """Combination that a curve shows."""

    scene: str
    scenario: str
    agent: str
    variant: Variant


def _group(row: Row) -> _Group:
    variant = {name: row.get(name) for name in Variant.__struct_fields__ if row.get(name) is not None}
    return _Group(str(row["scene"]), str(row["scenario"]), str(row["agent"]), msgspec.convert(variant, Variant))


def _place(row: Row) -> tuple[object, ...]:
    """Position of a row in tables: by group, in numerical order, then by intensity and seed."""
    group = _group(row)
    variant = group.variant
    numbers = variant.exposure_s, variant.diameter_scale, variant.start_speed_m_s, variant.gap_m
    axes = [(value is not None, value or 0) for value in numbers]
    water = [pair for on in (variant.mirror, variant.splashes, variant.spray) for pair in (on is not None, bool(on))]
    words = [each or "" for each in (variant.preset, variant.sensor, variant.friction)]
    own = variant.wet is not None, bool(variant.wet), *words, *water, *axes
    return *group[:3], *own, _number(row["intensity_mm_h"]), _number(row["seed"])


def _number(value: object) -> float:
    assert isinstance(value, int | float)
    return float(value)


# Sweep folder: a row and a roll-out per job, each written atomically; several sweeps may write to it together

_SUFFIX = ".parquet"


class SweepFolder:
    """Rows by job id. A row is written last, so an existing row implies that all other outputs exist."""

    def __init__(self, path: Path) -> None:
        """Use a folder, which is created on the first write."""
        self.path, self.log = path, path / "log.jsonl"
        self.rows, self.rollouts, self.clips = (path / name for name in ("rows", "rollouts", "clips"))
        self.clients = path / "clients"
        """Output of HUGSIM clients, a file for each job."""

    def describe(self, sweep: Sweep, jobs: Iterable[Job]) -> None:
        """Write sweep.json, and jobs.jsonl with the job of each id.

        Raises ValueError before any job runs if rows can't be written later.
        """
        parquet_modules()
        self.path.mkdir(parents=True, exist_ok=True)
        lines = sorted((job.id, msgspec.json.encode({"id": job.id, "job": job}, order="sorted")) for job in jobs)
        with whole_file(self.path / "sweep.json") as partial:
            partial.write_bytes(indented_json(sweep))
        with whole_file(self.path / "jobs.jsonl") as partial:
            partial.write_bytes(b"".join(line + b"\n" for _, line in lines))

    def keep(self, job: Job, outcome: JobResult) -> None:
        """Write a job's row and roll-out and log it; raises OSError and then leaves no partial file."""
        row = row_of(job, outcome)
        if outcome.rollout is not None:
            self.rollouts.mkdir(parents=True, exist_ok=True)
            write_rollout(self.rollouts / f"{job.id}.jsonl", outcome.rollout)
        self.rows.mkdir(parents=True, exist_ok=True)
        with whole_file(self.rows / f"{job.id}{_SUFFIX}") as partial:
            partial.write_bytes(rows_parquet([row], str(row["kind"])))
        self._note(job, outcome)

    def read(self, jobs: Iterable[Job]) -> dict[str, Row]:
        """Return the existing rows by job id. A damaged row counts as missing."""
        found: dict[str, Row] = {}
        for id in (job.id for job in jobs):
            try:
                rows = rows_in(read_file(self.rows / f"{id}{_SUFFIX}"))
            except (FileNotFoundError, ValueError):
                continue
            if len(rows) == 1 and rows[0].get("id") == id and "status" in rows[0]:
                found[id] = rows[0]
        return found

    def to_do(self, jobs: Sequence[Job], *, retry_failed: bool = False) -> list[Job]:
        """Return the jobs without a row, in order; includes failed jobs if `retry_failed`."""
        rows = self.read(jobs)
        done = {id for id, row in rows.items() if not retry_failed or row["status"] == FINISHED}
        return [job for job in jobs if job.id not in done]

    def others(self, jobs: Sequence[Job]) -> int:
        """Count rows that belong to other jobs (other settings, scenes or versions)."""
        own = {f"{job.id}{_SUFFIX}" for job in jobs}
        return sum(file.name not in own for file in self.rows.glob(f"[!.]*{_SUFFIX}"))

    def _note(self, job: Job, outcome: JobResult) -> None:
        """Append a log line with everything that differs between machines."""
        line = {
            "at": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "id": job.id,
            "job": job.title,
            "seconds": round(outcome.seconds, 3),
            "worker": outcome.worker,
            "error": outcome.error,
        }
        with self.log.open("ab+", buffering=0) as file:  # one write per line keeps lines of concurrent sweeps apart
            data = msgspec.json.encode(line) + b"\n"
            if file.seek(0, os.SEEK_END) and (file.seek(-1, os.SEEK_END), file.read(1))[1] != b"\n":
                data = b"\n" + data  # the last line was cut off by a full disk
            if file.write(data) != len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.log))
