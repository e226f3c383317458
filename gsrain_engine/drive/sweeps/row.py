"""The row of a job: its parameters and what came of it, with nothing in it of time or machine."""

import io
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import msgspec
from msgspec import inspect

from gsrain_engine.untrusted.printable import printable

from ..metrics.summary import DriveMetrics
from .job import DriveJob, Job
from .outcome import Outcome, Value

Row = dict[str, Value]

_MOST_ROWS = 10_000_000
"""Of a file; a job's has one."""

FINISHED, FAILED = "finished", "failed"

_SHARED: dict[str, type] = {
    "id": str, "kind": str, "status": str, "error": str, "scene": str, "scene_hash": str, "intensity_mm_h": float,
    "seed": int, "backend": str, "program": str, "software": str,
}  # fmt: skip
_DRIVE: dict[str, type] = {**_SHARED, "scenario": str, "agent": str, "agent_name": str}
_RENDER: dict[str, type] = {
    **_SHARED, "labels": str, "clip": str, "clip_hash": str, "cameras": int, "frames": int, "sizes_px": str,
    "implied_mm_h": float, "drops": int,
}  # fmt: skip
_TYPES: dict[type, type] = {
    inspect.BoolType: bool, inspect.IntType: int, inspect.FloatType: float, inspect.StrType: str
}  # fmt: skip


def columns_of(kind: str) -> dict[str, type]:
    """Return names and types of the columns of "drive" or "render" rows, in their order; all but the first may be None.

    What is measured of a drive are the fields of `DriveMetrics`.
    """
    if kind == "render":
        return _RENDER
    fields = inspect.type_info(DriveMetrics).fields  # pyright: ignore[reportAttributeAccessIssue]: that of a struct
    return {**_DRIVE, **{each.name: _plain(each.type) for each in fields if each.name not in _DRIVE}}


def row_of(job: Job, outcome: Outcome) -> Row:
    """Join a job and its outcome. What the job says goes before what was measured."""
    told: Mapping[str, Any] = {**outcome.values, **job.parameters}
    told = {**told, "status": FINISHED if outcome.error is None else FAILED, "error": outcome.error}
    kind = "drive" if isinstance(job, DriveJob) else "render"
    return {name: told.get(name) for name in columns_of(kind)}


def parquet(rows: Sequence[Row], kind: str) -> bytes:
    """Return rows as a Parquet file; the same rows give the same bytes."""
    arrow, files = parquet_modules()
    table = arrow.Table.from_pylist(list(rows), schema=_schema(kind))
    sink = io.BytesIO()
    files.write_table(table, sink, compression="zstd", use_dictionary=False, write_statistics=False)
    return sink.getvalue()


def rows_in(data: bytes) -> list[Row]:
    """Read a Parquet file of rows. Raises ValueError for what is none."""
    arrow, files = parquet_modules()
    try:
        with files.ParquetFile(io.BytesIO(data)) as file:
            if file.metadata.num_rows > _MOST_ROWS:
                raise ValueError(f"{file.metadata.num_rows} rows")
            return file.read().to_pylist()
    except (arrow.ArrowException, OSError, OverflowError, ValueError) as error:  # damage comes as any of them
        raise ValueError(f"no Parquet file: {printable(error)}") from None


def comma_separated(rows: Sequence[Row], kind: str) -> str:
    """Return rows as CSV: nothing where there is no value, true and false for what is one or the other."""
    lines = [",".join(columns_of(kind))]
    lines += [",".join(map(_cell, (row.get(name) for name in columns_of(kind)))) for row in rows]
    return "\n".join(lines) + "\n"


def _cell(value: Value) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    text = str(value)
    return '"' + text.replace('"', '""') + '"' if any(each in text for each in ',"\n\r') else text


def _schema(kind: str) -> Any:
    arrow, _ = parquet_modules()
    types = {str: arrow.string(), int: arrow.int64(), float: arrow.float64(), bool: arrow.bool_()}
    return arrow.schema([(name, types[each]) for name, each in columns_of(kind).items()])


def _plain(kind: inspect.Type) -> type:
    """Type of a column: that which stands in it where it is not None."""
    choices = kind.types if isinstance(kind, inspect.UnionType) else (kind,)
    return next(_TYPES[type(each)] for each in choices if type(each) in _TYPES)


def parquet_modules() -> tuple[Any, Any]:
    """The package, and its module of Parquet files; loaded where a row is written or read."""
    try:
        return import_module("pyarrow"), import_module("pyarrow.parquet")
    except ModuleNotFoundError:
        raise ValueError("rows of sweeps take the package pyarrow: pip install 'gsrain[drive]'") from None


def encoded(value: Any) -> bytes:
    """Return plain values as indented JSON."""
    return msgspec.json.format(msgspec.json.encode(value), indent=1) + b"\n"
