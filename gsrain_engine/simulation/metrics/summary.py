"""Metrics of drives: one summary per run, comparisons across rain intensities, CSV and result tables."""

import csv
import io
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from ...evaluation.image_metrics import MeanInterval, mean_interval
from ...safe_io.files import whole_file
from ...safe_io.text_files import escape_invisible
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

    def mean(self, metric: str, without_collision: bool = False) -> MeanInterval | None:
        """Return the mean of a `DriveMetrics` field over the runs with a value, with its 95 % bootstrap interval."""
        metrics = [each.metrics for each in self.runs if not (without_collision and each.metrics.collision)]
        values = [float(value) for each in metrics if (value := getattr(each, metric)) is not None]
        return mean_interval(values) if values else None


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


def write_metrics_csv(path: Path, metrics: Sequence[DriveMetrics]) -> None:
    """Write all metrics atomically."""
    with whole_file(path) as partial:
        text = table_csv(DriveMetrics.__struct_fields__, [msgspec.structs.asdict(each) for each in metrics])
        partial.write_bytes(text.encode())


def table_csv(columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> str:
    """Return rows as CSV; None is empty, booleans are true and false, numbers are not rounded."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        values = (row.get(name) for name in columns)
        writer.writerow([str(value).lower() if isinstance(value, bool) else value for value in values])
    return stream.getvalue()


# Results table, as in the paper: one row per scenario, agent and intensity, followed by definitions

NOT_MEASURED = "--"
"""The paper's entry for C and S after a collision: such runs end early, so their rates cover different roads."""


@dataclass(frozen=True, slots=True)
class ResultsTable:
    """Text of every cell; `DriveMetrics` holds the numbers."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    definitions: tuple[str, ...]
    """Definitions of columns."""

    @property
    def markdown(self) -> str:
        rule = ["---" if each in _WORDS else "---:" for each in self.columns]
        lines = [self.columns, rule, *self.rows]
        cells = [[escape_invisible(cell).replace("|", "\\|") for cell in line] for line in lines]
        table = "\n".join(f"| {' | '.join(line)} |" for line in cells)
        return table + "\n\n" + "\n".join(f"* {each}" for each in self.definitions) + "\n"

    @property
    def text(self) -> str:
        """Return the table and its definitions as plain text."""
        lines = [self.columns, *(tuple(map(escape_invisible, row)) for row in self.rows)]
        widths = [max(len(line[i]) for line in lines) for i in range(len(self.columns))]
        aligned = [f"{'<' if each in _WORDS else '>'}{width}" for each, width in zip(self.columns, widths, strict=True)]
        title, *rows = ("  ".join(map(format, line, aligned)) for line in lines)
        rule = "  ".join("-" * width for width in widths)
        notes = [textwrap.fill(each, max(_NARROWEST, len(rule)), subsequent_indent="  ") for each in self.definitions]
        return "\n".join(line.rstrip() for line in (title, rule, *rows, "", *notes)) + "\n"


_NARROWEST = 80  # minimum line width of the definitions in characters
_WORDS = ("Scenario", "Agent")


def results_table(comparisons: Sequence[DriveComparison]) -> ResultsTable:
    """Build the table. Rows of several seeds show means with 95 % bootstrap intervals in brackets."""
    has_seeds = any(len(weather.runs) > 1 for each in comparisons for weather in each.weathers)
    columns = (*_WORDS, "R (mm/h)", "Coll.", "Min. TTC (s)", "C", "C (frames)", "S (planned)", "S (executed)")
    rows: list[tuple[str, ...]] = []
    for each in comparisons:
        for weather in each.weathers:
            hits = weather.collisions
            rates = [
                _text(weather.mean(f"planned_{name}", without_collision=True), 1, " %")
                for name in ("point_collision_rate", "frame_collision_rate_hugsim")
            ]
            comfort = [
                _text(weather.mean(name, without_collision=True)) for name in ("comfort_planned", "comfort_executed")
            ]
            rain = "Clear" if weather.intensity_mm_h == 0 else f"{weather.intensity_mm_h:g}"
            collided = f"{hits} of {len(weather.runs)}" if has_seeds else ("Yes" if hits else "No")
            ttc = _text(weather.mean("min_ttc_s"))
            rows.append((each.scenario, each.agent, rain, collided, ttc, *rates, *comfort))
    return ResultsTable(columns, tuple(rows), _definitions(comparisons, has_seeds))


def _text(value: MeanInterval | None, digits: int = 3, unit: str = "") -> str:
    if value is None:
        return NOT_MEASURED
    mean, low, high = (f"{100 * each if unit else each:.{digits}f}" for each in value)
    return mean + unit if value.low == value.high else f"{mean} ({low}..{high}){unit}"


def _definitions(comparisons: Sequence[DriveComparison], has_seeds: bool) -> tuple[str, ...]:
    metrics = [run.metrics for each in comparisons for run in each.runs]
    points = " or ".join(str(each) for each in sorted({each.planned_points for each in metrics}))
    background = all(each.with_background for each in metrics)
    against = "road users or the background" if background else "road users (the background was not tested)"
    seeds = (
        "Several seeds: means with 95 % bootstrap intervals; C and S over the runs without a collision. "
        if has_seeds else ""
    )  # fmt: skip
    return (
        "Coll.: whether the ego vehicle's box touches a road user's or the background.",
        "Min. TTC: the least over the run of min(d_x / (v_SUT - v_BV), 10 s), d_x the gap from the front bumper to who "
        "is in the vehicle's lane; 10 s where nobody slower is ahead, 0 at a touch.",
        f"C: share of all planned points (N = {points} a frame) at which the vehicle would touch {against}, at the "
        "places where road users really were at that time.",
        "C (frames): share of frames with any such point, the last of each plan left out (HUGSIM: 1 - mean nc).",
        "S (planned): share of frames whose plan keeps all comfort limits (HUGSIM: acceleration -4.05..2.40 m/s2, jerk "
        "8.37 m/s3, yaw rate 0.95 rad/s, yaw acceleration 1.93 rad/s2; the lateral one is never felt).",
        "S (executed): share of driven steps that keep them, with 4.89 m/s2 to the side.",
        f"{seeds}{NOT_MEASURED}: not said after a collision, as in the paper; "
        "the numbers are in the CSV and JSON files.",
    )
