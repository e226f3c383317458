"""What `gsrain sweep` shows of the drives that it made: a row an agent and intensity."""

from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

from ..console import Console, Table

_COLUMNS = 160
_SHOWN = {"min_ttc_s": "min TTC (s)", "planned_point_collision_rate": "C (points)", "comfort_executed": "S (driven)"}


def print_cells(cells: Sequence[Mapping[str, Any]]) -> None:
    """Print the cells of a summary with their intervals."""
    several = len({cell["scene"] for cell in cells}) > 1
    table = Table(box=None, pad_edge=False)
    for title in [*(["scene"] if several else []), "scenario", "agent"]:
        table.add_column(title, no_wrap=True)
    for title in ("R (mm/h)", "drives", "collisions", *_SHOWN.values()):
        table.add_column(title, justify="right", no_wrap=True)
    for cell in cells:
        collisions = cell["collision_rate"]
        table.add_row(
            *([PurePath(cell["scene"]).name] if several else []),
            cell["scenario"],
            cell["agent"],
            f"{cell['intensity_mm_h']:g}",
            f"{cell['runs']}" + (f" + {cell['failed']} failed" if cell["failed"] else ""),
            "-" if collisions is None else f"{cell['collisions']} ({_share(collisions)})",
            *(_mean(cell["means"].get(name)) for name in _SHOWN),
        )
    console = Console(width=_COLUMNS, highlight=False)
    console.print(table)
    console.print("In brackets: intervals of 95 %, over the seeds.", style="dim")


def _share(spread: Mapping[str, float]) -> str:
    return f"{100 * spread['low']:.0f} to {100 * spread['high']:.0f} %"


def _mean(spread: Mapping[str, float] | None) -> str:
    if spread is None:
        return "-"
    mean, low, high = (f"{spread[name]:.3g}" for name in ("mean", "low", "high"))
    return mean if low == high else f"{mean} ({low} to {high})"
