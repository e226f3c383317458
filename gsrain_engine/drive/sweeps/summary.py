"""What the rows of a sweep say together: at each intensity the share of collisions, and means, with their bands."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from msgspec import Struct
from scipy.stats import binomtest

from gsrain_engine.evaluate.mean_interval import CONFIDENCE, mean_interval

from .row import FINISHED, Row

MEASURED: dict[str, str] = {
    "min_ttc_s": "min TTC (s)",
    "planned_point_collision_rate": "C points",
    "planned_frame_collision_rate": "C frames",
    "comfort_executed": "S driven",
    "comfort_planned": "S planned",
    "route_completion": "route",
}
"""Columns whose means are told, and what tables call them."""


class Spread(Struct, frozen=True):
    """A mean with the ends between which it lies with 95 %."""

    mean: float
    low: float
    high: float
    count: int
    """Runs that it is of; those that have no value are left out."""


class Group(NamedTuple):
    """What a curve is of."""

    scene: str
    scenario: str
    agent: str


class Cell(Struct, frozen=True, kw_only=True):
    """All seeds of one group at one intensity."""

    scene: str
    scenario: str
    agent: str
    intensity_mm_h: float
    runs: int
    """Finished ones: those that failed tell nothing."""
    failed: int
    collisions: int
    collision_rate: Spread | None
    """Share of the runs, with Wilson's interval (Wilson 1927)."""
    means: dict[str, Spread]
    """Of the columns in `MEASURED`, over the seeds, with bootstrap bands. Without a column that no run has."""
    changes: dict[str, Spread]
    """The same of the differences from the lowest intensity, seed by seed: what rain does to one and the same drive."""

    @property
    def group(self) -> Group:
        return Group(self.scene, self.scenario, self.agent)


def summarized(rows: Iterable[Row]) -> list[Cell]:
    """Summarize the rows of drives, in the order of their parameters."""
    told = sorted(rows, key=lambda row: (*_group(row), _number(row["intensity_mm_h"]), _number(row["seed"])))
    cells: list[Cell] = []
    for group in dict.fromkeys(map(_group, told)):
        own = [row for row in told if _group(row) == group]
        intensities = list(dict.fromkeys(_number(row["intensity_mm_h"]) for row in own))
        at = {each: [row for row in own if row["intensity_mm_h"] == each] for each in intensities}
        cells += [_cell(group, each, at[each], at[intensities[0]]) for each in intensities]
    return cells


def by_scenario(cells: Iterable[Cell]) -> list[list[Cell]]:
    """Return the cells of each scenario in each scene, in their order."""
    cells = list(cells)
    places = list(dict.fromkeys((cell.scene, cell.scenario) for cell in cells))
    return [[cell for cell in cells if (cell.scene, cell.scenario) == place] for place in places]


def _cell(group: Group, intensity: float, rows: Sequence[Row], lowest: Sequence[Row]) -> Cell:
    finished = [row for row in rows if row["status"] == FINISHED]
    collisions = sum(bool(row["collision"]) for row in finished)
    means = {name: _spread([_number(row[name]) for row in finished if row[name] is not None]) for name in MEASURED}
    changes = {name: _spread(_changes(name, finished, lowest)) for name in MEASURED} if rows is not lowest else {}
    return Cell(
        **group._asdict(),
        intensity_mm_h=intensity,
        runs=len(finished),
        failed=len(rows) - len(finished),
        collisions=collisions,
        collision_rate=_share(collisions, len(finished)) if finished else None,
        means={name: each for name, each in means.items() if each is not None},
        changes={name: each for name, each in changes.items() if each is not None},
    )


def _changes(name: str, rows: Sequence[Row], lowest: Sequence[Row]) -> list[float]:
    before = {row["seed"]: row[name] for row in lowest if row["status"] == FINISHED and row[name] is not None}
    pairs = [(row[name], before[row["seed"]]) for row in rows if row[name] is not None and row["seed"] in before]
    return [_number(later) - _number(earlier) for later, earlier in pairs]


def _spread(values: list[float]) -> Spread | None:
    return Spread(*mean_interval(values), len(values)) if values else None


def _share(count: int, runs: int) -> Spread:
    interval = binomtest(count, runs).proportion_ci(CONFIDENCE, method="wilson")
    return Spread(count / runs, float(interval.low), float(interval.high), runs)


def _group(row: Row) -> Group:
    return Group(str(row["scene"]), str(row["scenario"]), str(row["agent"]))


def _number(value: object) -> float:
    assert isinstance(value, int | float)
    return float(value)
