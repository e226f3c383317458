"""Metrics of drives: one summary per run, comparisons across rain intensities, CSV and result tables."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta, structs

from ...report.interval import Interval
from ...report.table import Cell, Column, Table, table_of
from ..obstacles import Drivable, OccupiedSpace
from ..rollout import Rollout
from ..rollout_io import write_rollout
from .collisions import first_collision, gaps_m, planned_collisions, times_to_collision_s
from .comfort import NUPLAN, comfort_executed, comfort_planned
from .hd_score import hd_score

Share = Annotated[float, Meta(ge=0, le=1)]


class DriveMetrics(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Metrics of a run; None where undefined. Names with `hugsim` omit each plan's last point."""

    scenario: str
    scene: str
    agent: str
    intensity_mm_h: float
    seed: int
    steps: int  # number of driven steps, one less than recorded steps
    frames: int  # F: steps with a plan
    planned_points: int  # N: points of a plan
    duration_s: float
    end: str  # reason of the end: "collision", "completed", "off route", "time", "agent", "stopped"
    collision: bool
    collided_with: str | None  # id of the road user, or "background"
    collision_time_s: float | None
    collision_speed_m_s: float | None  # ego speed
    collision_closing_speed_m_s: float | None
    min_ttc_s: Annotated[float, Meta(ge=0, le=10)]  # minimum time to collision, from the bumper gap
    min_ttc_time_s: float  # time of the minimum
    min_ttc_center_s: Annotated[float, Meta(ge=0, le=10)]  # minimum time to collision, from the center distance
    min_gap_m: float | None  # minimum bumper gap to road users ahead in the lane; None without any
    planned_point_collision_rate: Share | None  # the paper's C, of all planned points
    planned_point_collision_rate_hugsim: Share | None
    planned_frame_collision_rate: Share | None  # share of frames with any planned point that collides
    planned_frame_collision_rate_hugsim: Share | None
    comfort_executed: Share | None  # the paper's S of the executed motion
    comfort_executed_nuplan: Share | None  # the same with nuPlan's jerk limits
    comfort_planned: Share | None  # the paper's S of the plans: HUGSIM's comfort
    comfort_planned_nuplan: Share | None
    route_completion: Share  # driven share of the route ahead of the start
    distance_m: float
    mean_speed_m_s: float  # distance over duration; 0 without motion
    hardest_braking_m_s2: float  # largest deceleration of a step, 0 or more
    with_background: bool  # true if planned points were also tested against the background
    nc: Share | None  # this field and the next six: see `HdScore`
    dac: Share | None
    ttc: Share | None
    c: Share | None
    pdms: Share | None
    rc: Share | None
    hdscore: Share | None

    @property
    def collided(self) -> bool:
        """True if the ego vehicle hit a road user or the background."""
        return self.collision


def measure_drive(
    rollout: Rollout, occupied: OccupiedSpace | None = None, drivable: Drivable | None = None
) -> DriveMetrics:
    """Measure a run. `occupied` and `drivable` describe its world; without them they are not scored.

    Raises ValueError if the roll-out's vehicle can't be read.
    """
    hit = first_collision(rollout)
    times, gaps = times_to_collision_s(rollout), gaps_m(rollout)
    every, five = planned_collisions(rollout, occupied), planned_collisions(rollout, occupied, "hugsim")
    score = hd_score(rollout, occupied, drivable)
    places = np.array([(each.ego.x_m, each.ego.y_m) for each in rollout.steps])
    distance = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
    duration = rollout.steps[-1].time_s - rollout.steps[0].time_s
    return DriveMetrics(
        scenario=rollout.scenario_name,
        scene=rollout.scene,
        agent=rollout.agent,
        intensity_mm_h=rollout.intensity_mm_h,
        seed=rollout.seed,
        steps=len(rollout.steps) - 1,
        frames=len(rollout.planned_frames),
        planned_points=every.points_per_frame,
        duration_s=duration,
        end=rollout.end,
        collision=hit is not None,
        collided_with=hit and hit.who,
        collision_time_s=hit and hit.time_s,
        collision_speed_m_s=hit and hit.speed_m_s,
        collision_closing_speed_m_s=hit and hit.closing_speed_m_s,
        min_ttc_s=float(times.min()),
        min_ttc_time_s=rollout.steps[int(times.argmin())].time_s,
        min_ttc_center_s=float(times_to_collision_s(rollout, "center").min()),
        min_gap_m=float(gaps.min()) if np.isfinite(gaps).any() else None,
        planned_point_collision_rate=every.point_rate,
        planned_point_collision_rate_hugsim=five.point_rate,
        planned_frame_collision_rate=every.frame_rate,
        planned_frame_collision_rate_hugsim=five.frame_rate,
        comfort_executed=comfort_executed(rollout),
        comfort_executed_nuplan=comfort_executed(rollout, NUPLAN),
        comfort_planned=comfort_planned(rollout),
        comfort_planned_nuplan=comfort_planned(rollout, NUPLAN),
        route_completion=max(each.route_completion for each in rollout.steps),
        distance_m=distance,
        mean_speed_m_s=distance / duration if duration > 0 else 0.0,
        hardest_braking_m_s2=max(0.0, *(-each.ego.acceleration_m_s2 for each in rollout.steps)),
        with_background=occupied is not None,
        **{name: score and getattr(score, name) for name in ("nc", "dac", "ttc", "c", "pdms", "rc", "hdscore")},
    )


# Comparison across rain intensities


class ScoredRun(NamedTuple):
    """A run with its metrics."""

    metrics: DriveMetrics
    rollout: Rollout | None = None
    """Required for figures over time, not for tables."""

    @classmethod
    def of(
        cls, rollout: Rollout, occupied: OccupiedSpace | None = None, drivable: Drivable | None = None
    ) -> "ScoredRun":
        """Measure a roll-out."""
        return cls(measure_drive(rollout, occupied, drivable), rollout)

    def __repr__(self) -> str:
        of = self.metrics
        about = f"{of.agent} in {of.intensity_mm_h:g} mm/h, {of.steps} steps, end: {of.end}"
        return f"<gsrain.Run of {of.scenario}: {about}>"

    def save(self, path: Path | str) -> None:
        """Write the roll-out as JSON lines, which the editor plays; raises `ValueError` without a roll-out."""
        if self.rollout is None:
            raise ValueError(f"{path}: this run has metrics but no roll-out to be written")
        write_rollout(Path(path), self.rollout)


@dataclass(frozen=True, slots=True)
class IntensityRuns:
    """The runs of one scenario and agent at one rain intensity."""

    intensity_mm_h: float
    runs: tuple[ScoredRun, ...]
    """Runs sorted by seed."""

    @property
    def collisions(self) -> int:
        return sum(run.metrics.collision for run in self.runs)

    def mean(self, metric: str) -> Interval | None:
        """Return the mean of a `DriveMetrics` field, see `mean_of`."""
        return mean_of(metric, (structs.asdict(each.metrics) for each in self.runs))


@dataclass(frozen=True, slots=True)
class DriveComparison:
    """One scenario and agent at several rain intensities."""

    scenario: str
    agent: str
    scene: str
    weathers: tuple[IntensityRuns, ...]  # sorted by intensity, clear weather first

    @property
    def title(self) -> str:
        return f"{self.scenario}, {self.agent}"

    @property
    def runs(self) -> tuple[ScoredRun, ...]:
        return tuple(run for weather in self.weathers for run in weather.runs)


def compare_drives(runs: Iterable[ScoredRun]) -> tuple[DriveComparison, ...]:
    """Group runs by scenario, agent and scene in order of appearance, then by intensity and seed."""
    groups: dict[tuple[str, str, str], dict[float, list[ScoredRun]]] = {}
    runs = list(runs)
    for run in runs:
        groups.setdefault((run.metrics.scenario, run.metrics.agent, run.metrics.scene), {})
    for run in sorted(runs, key=lambda each: (each.metrics.intensity_mm_h, each.metrics.seed)):
        group = groups[run.metrics.scenario, run.metrics.agent, run.metrics.scene]
        group.setdefault(run.metrics.intensity_mm_h, []).append(run)
    return tuple(
        DriveComparison(*key, tuple(IntensityRuns(intensity, tuple(own)) for intensity, own in group.items()))
        for key, group in groups.items()
    )


def metrics_table(metrics: Sequence[DriveMetrics]) -> Table:
    """Return all metrics of runs, by their names in `DriveMetrics`."""
    return table_of("Metrics", DriveMetrics.__struct_fields__, map(structs.asdict, metrics))


# Results table, as in the paper: one row per scenario, agent and intensity, followed by definitions

NOT_MEASURED = "--"
"""The paper's entry for C and S after a collision: such runs end early, so their rates cover different roads."""

RATE = Column("R", "g", "mm/h")
COLLISIONS = Column(
    "Coll.", ".0%", definition="whether the ego vehicle's box touches a road user's or the background; of several "
    "drives, the share.",
)  # fmt: skip

RESULT_COLUMNS: Mapping[str, Column] = {
    "min_ttc_s": Column(
        "Min. TTC", ".3f", "s", definition="the least over the drive of min(d_x / (v_SUT - v_BV), 10 s), d_x the gap "
        "from the front bumper to who is in the vehicle's lane; 10 s where nobody slower is ahead, 0 at a touch.",
    ),
    "planned_point_collision_rate": Column(
        "C (all points)", ".1%", missing=NOT_MEASURED, definition="share of all planned points at which the vehicle "
        "would touch something, at the places where road users really were at that time.",
    ),
    "planned_point_collision_rate_hugsim": Column(
        "C (N = 5)", ".1%", missing=NOT_MEASURED, definition="the same without the last point of each plan, by which "
        "six points become the paper's N of five.",
    ),
    "planned_frame_collision_rate_hugsim": Column(
        "C (HUGSIM)", ".1%", missing=NOT_MEASURED, definition="share of frames with any such point, the last of each "
        "plan left out (HUGSIM: 1 - mean nc).",
    ),
    "comfort_planned": Column(
        "S (planned)", ".3f", missing=NOT_MEASURED, definition="share of frames whose plan keeps all comfort limits "
        "(HUGSIM: acceleration -4.05..2.40 m/s2, jerk 8.37 m/s3, yaw rate 0.95 rad/s, yaw acceleration 1.93 rad/s2; "
        "the lateral one is never felt).",
    ),
    "comfort_executed": Column(
        "S (executed)", ".3f", missing=NOT_MEASURED, definition="share of driven steps that keep them, with 4.89 m/s2 "
        "to the side.",
    ),
}  # fmt: skip
"""Columns of the results of drives and of sweeps, by the fields of `DriveMetrics`."""

AFTER_COLLISION = f"{NOT_MEASURED}: no value after a collision, as in the paper; table.csv has the numbers."


def is_measured(metric: str, drive: Mapping[str, Any]) -> bool:
    """Return whether a drive's metric is known and has a meaning: after a collision, C and S have none."""
    column = RESULT_COLUMNS.get(metric)
    until_collision = column is not None and column.missing == NOT_MEASURED
    return drive[metric] is not None and not (until_collision and drive["collision"])


def mean_of(metric: str, drives: Iterable[Mapping[str, Any]]) -> Interval | None:
    """Return the mean of a metric over the drives in which `is_measured`, with its interval; None without any."""
    values = [float(each[metric]) for each in drives if is_measured(metric, each)]
    return Interval.bootstrap(values, "drives") if values else None


def results_table(comparisons: Sequence[DriveComparison]) -> Table:
    """Build the table; rows of several seeds have means with intervals."""
    weathers = [(each, weather) for each in comparisons for weather in each.weathers]
    has_seeds = any(len(weather.runs) > 1 for _, weather in weathers)
    rows: list[tuple[Cell, ...]] = []
    for each, weather in weathers:
        hits, of = weather.collisions, len(weather.runs)
        collided = Interval.wilson(hits, of, "drives") if has_seeds else hits > 0
        means = (weather.mean(metric) for metric in RESULT_COLUMNS)
        rows.append((each.scenario, each.agent, weather.intensity_mm_h, collided, *means))
    titled = Column("Scenario"), Column("Agent"), RATE, COLLISIONS, *RESULT_COLUMNS.values()
    metrics = [run.metrics for _, weather in weathers for run in weather.runs]
    points = " or ".join(str(each) for each in sorted({each.planned_points for each in metrics}))
    background = all(each.with_background for each in metrics)
    tested = "road users and the background" if background else "road users (the background was not tested)"
    caption = f"Plans have N = {points} points, tested against {tested}. {AFTER_COLLISION}"
    return Table("Results", titled, rows, caption)
