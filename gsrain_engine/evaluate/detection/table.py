"""The rows of a sweep as files: CSV for everybody, Parquet for data frames."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gsrain_engine.scene.atomic_files import whole_file

from .sweep import Row


def write_csv(file: Path, rows: Sequence[Row]) -> None:
    """Write rows as CSV with a line of names; a miss has a confidence of 0, unknowns are empty."""
    with whole_file(file) as beside, beside.open("w", encoding="utf-8", newline="") as stream:
        names = list(rows[0].plain()) if rows else []
        writer = csv.DictWriter(stream, names)
        writer.writeheader()
        writer.writerows({k: _rounded(v) for k, v in row.plain().items()} for row in rows)


def write_parquet(file: Path, rows: Sequence[Row]) -> bool:
    """Write rows as Parquet; False, and nothing written, where pyarrow is not installed."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ModuleNotFoundError:
        return False
    table: Any = pyarrow.Table.from_pylist([row.plain() for row in rows])
    with whole_file(file) as beside:
        parquet.write_table(table, beside)
    return True


def _rounded(value: object) -> object:
    return round(value, 6) if isinstance(value, float) else value
