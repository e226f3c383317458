"""What `gsrain evaluate lidar` tells of its runs: on the screen, as JSON, and as a table."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gsrain_engine.evaluate.lidar.runs import RunCounts
from gsrain_engine.evaluate.lidar.sensor import LidarSensor
from gsrain_engine.evaluate.lidar.tally import Tally
from gsrain_engine.scene.atomic_files import whole_file

from ...console import Console, Table

_FEWEST = 20
_COUNTED = ("clear", "kept", "dropped", "masked", "false")


def lidar_report(
    by_intensity: Mapping[float, Sequence[RunCounts]], sensor: LidarSensor, **settings: Any
) -> dict[str, Any]:
    """Everything as plain values: a row for each turn, intensity and seed."""
    rows = [_row(run) for runs in by_intensity.values() for run in runs]
    return {**settings, "sensor": msgspec.to_builtins(sensor), "rows": rows}


def _row(run: RunCounts) -> dict[str, Any]:
    tally = run.tally
    return {
        "intensity_mm_h": run.state.intensity_mm_h,
        "seed": run.seed,
        "turn": run.turn,
        "extinction_per_m": run.state.extinction_per_m,
        "wetness": run.wetness,
        "range_10_m": run.range_m,
        **{name: int(getattr(tally, name).sum()) for name in _COUNTED},
        "untouched": tally.untouched,
        "at_threshold": run.at_threshold,
        "range_rmse_m": None if math.isnan(tally.range_rmse_m) else tally.range_rmse_m,
        "by_range": _by_range(tally),
    }


def _by_range(tally: Tally) -> list[dict[str, Any]]:
    ends = zip(tally.edges_m[:-1].tolist(), tally.edges_m[1:].tolist(), strict=True)
    return [
        {"from_m": start, "to_m": None if math.isinf(end) else end}
        | {name: int(getattr(tally, name)[k]) for name in _COUNTED}
        for k, (start, end) in enumerate(ends)
    ]


def write_lidar_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a CSV line for each run and bin of range; the last bin has no end."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["intensity_mm_h", "seed", "turn", "from_m", "to_m", *_COUNTED])
    for row in rows:
        for part in row["by_range"]:
            writer.writerow([row["intensity_mm_h"], row["seed"], row["turn"], *part.values()])
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as beside:
        beside.write_text(text.getvalue(), encoding="utf-8")


def print_lidar(by_intensity: Mapping[float, Sequence[RunCounts]], sensor: LidarSensor, console: Console) -> None:
    """Print means over seeds and turns, with their spread, and the shares that are kept by range."""
    table = Table("mm/h", "beta 1/km", "wetness", "clear", "kept", "too weak", "behind a drop", "drops", box=None)
    table.add_column("noise mm")
    for intensity, runs in by_intensity.items():
        tallies = [run.tally for run in runs]
        clear, kept = (int(np.sum([getattr(each, name) for each in tallies])) for name in ("clear", "kept"))
        table.add_row(
            f"{intensity:g}",
            f"{1e3 * runs[0].state.extinction_per_m:.2f}",
            f"{runs[0].wetness:.2f}",
            f"{clear / len(runs):,.0f}",
            f"{kept / max(clear, 1):.2%}",
            *(_spread([int(getattr(each, name).sum()) for each in tallies]) for name in ("dropped", "masked", "false")),
            f"{1e3 * np.mean([each.range_rmse_m for each in tallies]):.1f}",
        )
    console.print(f"{sensor.name}; 10 % is detected up to {sensor.range_m:.0f} m")
    console.print(table)
    first = next(iter(by_intensity.values()))
    runs_each, just = len(first), sum(run.at_threshold for run in first)
    console.print(f"Means of {runs_each} runs each, with the least and the most of them. Kept returns by range:")
    console.print(_kept_by_range(by_intensity))
    if just:
        console.print(
            f"{just / runs_each:,.0f} clear returns are fainter than what is just detected: they are taken to be at "
            "that limit, and any rain loses them.",
            soft_wrap=True,
        )


def _kept_by_range(by_intensity: Mapping[float, Sequence[RunCounts]]) -> Table:
    """Shares of the clear returns; bins that few of these are in are left out."""
    sums = {
        intensity: [np.sum([getattr(run.tally, name) for run in runs], axis=0) for name in ("kept", "clear")]
        for intensity, runs in by_intensity.items()
    }
    first = next(iter(by_intensity.values()))
    edges, clear = first[0].tally.edges_m.tolist(), next(iter(sums.values()))[1]
    shown = [k for k in range(len(clear)) if clear[k] >= _FEWEST * len(first)]
    ends = [f"{edges[k]:g}-{edges[k + 1]:g} m" if math.isfinite(edges[k + 1]) else f"> {edges[k]:g} m" for k in shown]
    table = Table("mm/h", *ends, box=None)
    for intensity, (kept, clear) in sums.items():
        table.add_row(f"{intensity:g}", *(f"{kept[k] / clear[k]:.1%}" for k in shown))
    return table


def _spread(counts: Sequence[int]) -> str:
    mean = sum(counts) / len(counts)
    return f"{mean:,.0f}" if min(counts) == max(counts) else f"{mean:,.0f} ({min(counts):,}..{max(counts):,})"
