"""Metrics of runs as CSV: one row a run, one column a metric."""

import csv
from collections.abc import Sequence
from pathlib import Path

import msgspec

from gsrain_engine.scene.atomic_files import whole_file

from .summary import DriveMetrics


def write_metrics_csv(path: Path, metrics: Sequence[DriveMetrics]) -> None:
    """Write all metrics, whole or not at all; what could not be measured is empty, numbers are not rounded."""
    with whole_file(path) as beside, beside.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(DriveMetrics.__struct_fields__), lineterminator="\n")
        writer.writeheader()
        writer.writerows({key: _cell(value) for key, value in msgspec.structs.asdict(each).items()} for each in metrics)


def _cell(value: object) -> object:
    return str(value).lower() if isinstance(value, bool) else value
