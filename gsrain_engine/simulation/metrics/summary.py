"""All metrics of one run in one value: what `gsrain drive --json` writes and what a sweep keeps of each run."""

import csv
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from ...evaluation.image_metrics import MeanInterval, mean_interval
from ...safe_io.text_files import escape_invisible
from ...scene.files import whole_file
from ..rollout import Rollout, planned_frames, run_setting
from ..rollout_io import write_rollout
from .collisions import CollisionSpace, first_collision, gaps_m, planned_collisions, times_to_collision_s
from .comfort import NUPLAN, comfort_executed, comfort_planned
from .hd_score import DrivableArea, HdScore, hd_score

Share = Annotated[float, Meta(ge=0, le=1)]


class DriveMetrics(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Metrics of a run; None where nothing can be measured. Names with `hugsim` leave out each plan's last point."""

    scenario: str
    scene: str
    agent: str
    intensity_mm_h: float
    seed: int
    steps: int
    """Driven: one less than there are moments."""
    frames: int
    """F: moments with a plan."""
    planned_points: int
    """N: points of a plan."""
    duration_s: float
    end: str
    """Why it ended: "collision", "completed", "off route", "time", "agent", "stopped"."""
    collision: bool
    collided_with: str | None
    """Id of the road user, or "background"."""
    collision_time_s: float | None
    collision_speed_m_s: float | None
    """Of the ego vehicle."""
    collision_closing_speed_m_s: float | None
    min_ttc_s: Annotated[float, Meta(ge=0, le=10)]
    """Least time to collision, from the bumper gap."""
    min_ttc_time_s: float
    """When it was."""
    min_ttc_center_s: Annotated[float, Meta(ge=0, le=10)]
    """The same, from middle to middle."""
    min_gap_m: float | None
    """Least bumper gap to anybody ahead in the lane; None where nobody ever was."""
    planned_point_collision_rate: Share | None
    """The paper's C, of all planned points."""
    planned_point_collision_rate_hugsim: Share | None
    planned_frame_collision_rate: Share | None
    """Share of frames with any planned point that collides."""
    planned_frame_collision_rate_hugsim: Share | None
    comfort_executed: Share | None
    """The paper's S, of the motion as driven."""
    comfort_executed_nuplan: Share | None
    """With nuPlan's limits of the jerk."""
    comfort_planned: Share | None
    """The paper's S, of the plans: HUGSIM's comfort."""
    comfort_planned_nuplan: Share | None
    route_completion: Share
    """Share of the route ahead of the start that was driven."""
    distance_m: float
    mean_speed_m_s: float
    """Distance over duration; 0 where nothing was driven."""
    hardest_braking_m_s2: float
    """Largest deceleration of a step, 0 or more."""
    with_background: bool
    """Whether planned points were tested against the background too."""
    nc: Share | None
    """This and the next six: see `HdScore`."""
    dac: Share | None
    ttc: Share | None
    c: Share | None
    pdms: Share | None
    rc: Share | None
    hdscore: Share | None

    @property
    def collided(self) -> bool:
        """Whether the ego vehicle hit a road user or the background."""
        return self.collision


def measure_drive(
    rollout: Rollout, occupied: CollisionSpace | None = None, drivable: DrivableArea | None = None
) -> DriveMetrics:
    """Measure a run. `occupied` and `drivable` are of the world that it was driven in; without them they don't count.

    Raises ValueError for a roll-out whose vehicle can't be read.
    """
    setting, hit = run_setting(rollout), first_collision(rollout)
    times, gaps = times_to_collision_s(rollout), gaps_m(rollout)
    every, five = planned_collisions(rollout, occupied), planned_collisions(rollout, occupied, "hugsim")
    score = hd_score(rollout, occupied, drivable)
    distance, duration = _driven_m(rollout), rollout.steps[-1].time_s - rollout.steps[0].time_s
    return DriveMetrics(
        scenario=setting.scenario,
        scene=rollout.scene,
        agent=rollout.agent,
        intensity_mm_h=setting.intensity_mm_h,
        seed=rollout.seed,
        steps=len(rollout.steps) - 1,
        frames=len(planned_frames(rollout)),
        planned_points=every.points_per_frame,
        duration_s=duration,
        end=rollout.end,
        collision=hit is not None,
        collided_with=None if hit is None else hit.who,
        collision_time_s=None if hit is None else hit.time_s,
        collision_speed_m_s=None if hit is None else hit.speed_m_s,
        collision_closing_speed_m_s=None if hit is None else hit.closing_speed_m_s,
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
        **_parts(score),
    )


def _driven_m(rollout: Rollout) -> float:
    places = np.array([(each.ego.x_m, each.ego.y_m) for each in rollout.steps])
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def _parts(score: HdScore | None) -> dict[str, Any]:
    names = ("nc", "dac", "ttc", "c", "pdms", "rc", "hdscore")
    return {name: None if score is None else getattr(score, name) for name in names}


# § Runs side by side: by scenario and agent, in rows by rain intensity, with what varies between seeds.


class ScoredRun(NamedTuple):
    """A run with its metrics."""

    metrics: DriveMetrics
    rollout: Rollout | None = None
    """What figures over time need; tables do without."""

    @classmethod
    def of(
        cls, rollout: Rollout, occupied: CollisionSpace | None = None, drivable: DrivableArea | None = None
    ) -> "ScoredRun":
        """Measure a roll-out."""
        return cls(measure_drive(rollout, occupied, drivable), rollout)

    def save(self, path: Path | str) -> None:
        """Write the roll-out as JSON lines, which the window plays; raises `ValueError` where there is none."""
        if self.rollout is None:
            raise ValueError(f"{path}: this run has metrics but no roll-out to be written")
        write_rollout(Path(path), self.rollout)


@dataclass(frozen=True, slots=True)
class IntensityRuns:
    """The runs of one scenario and agent in rain of one intensity."""

    intensity_mm_h: float
    runs: tuple[ScoredRun, ...]
    """By seed."""

    @property
    def collisions(self) -> int:
        return sum(run.metrics.collision for run in self.runs)

    def mean(self, metric: str, without_collision: bool = False) -> MeanInterval | None:
        """Return a metric's mean over the runs that have it, with its 95 % bootstrap interval; None where none has.

        `metric` is a field of `DriveMetrics`. Of one run the interval is the value itself.
        """
        metrics = [each.metrics for each in self.runs if not (without_collision and each.metrics.collision)]
        values = [float(value) for each in metrics if (value := getattr(each, metric)) is not None]
        return mean_interval(values) if values else None


@dataclass(frozen=True, slots=True)
class DriveComparison:
    """One scenario driven by one agent, in several weathers."""

    scenario: str
    agent: str
    scene: str
    weathers: tuple[IntensityRuns, ...]
    """By intensity, the clear one first."""

    @property
    def title(self) -> str:
        return f"{self.scenario}, {self.agent}"

    @property
    def runs(self) -> tuple[ScoredRun, ...]:
        return tuple(run for weather in self.weathers for run in weather.runs)


def compare_drives(runs: Iterable[ScoredRun]) -> tuple[DriveComparison, ...]:
    """Group runs by scenario, agent and scene, as they first come; in each by intensity, then by seed."""
    groups: dict[tuple[str, str, str], list[ScoredRun]] = {}
    for run in runs:
        groups.setdefault((run.metrics.scenario, run.metrics.agent, run.metrics.scene), []).append(run)
    return tuple(DriveComparison(*key, _by_weather(own)) for key, own in groups.items())


def _by_weather(runs: list[ScoredRun]) -> tuple[IntensityRuns, ...]:
    by_intensity: dict[float, list[ScoredRun]] = {}
    for run in sorted(runs, key=lambda each: (each.metrics.intensity_mm_h, each.metrics.seed)):
        by_intensity.setdefault(run.metrics.intensity_mm_h, []).append(run)
    return tuple(IntensityRuns(intensity, tuple(own)) for intensity, own in by_intensity.items())


# § Metrics of runs as CSV: one row a run, one column a metric.


def write_metrics_csv(path: Path, metrics: Sequence[DriveMetrics]) -> None:
    """Write all metrics, whole or not at all; what could not be measured is empty, numbers are not rounded."""
    with whole_file(path) as beside, beside.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(DriveMetrics.__struct_fields__), lineterminator="\n")
        writer.writeheader()
        writer.writerows({key: _cell(value) for key, value in msgspec.structs.asdict(each).items()} for each in metrics)


def _cell(value: object) -> object:
    return str(value).lower() if isinstance(value, bool) else value


# § The table of results, as in the paper: one row a scenario, agent and intensity, with the definitions below it.

NOT_MEASURED = "--"
"""What the paper prints for C and S after a collision: such runs end early, and their rates are of other roads."""


@dataclass(frozen=True, slots=True)
class ResultsTable:
    """Words for every cell; numbers are in `DriveMetrics`."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    definitions: tuple[str, ...]
    """A sentence for each column that needs one."""

    @property
    def markdown(self) -> str:
        rule = ["---" if each in _WORDS else "---:" for each in self.columns]
        lines = [self.columns, rule, *self.rows]
        table = "\n".join("| " + " | ".join(_plain(cell) for cell in line) + " |" for line in lines)
        return table + "\n\n" + "\n".join(f"* {each}" for each in self.definitions) + "\n"

    @property
    def text(self) -> str:
        """The table and its definitions, in columns of characters."""
        lines = [self.columns, *(tuple(map(escape_invisible, row)) for row in self.rows)]
        widths = [max(len(line[i]) for line in lines) for i in range(len(self.columns))]
        is_word = [each in _WORDS for each in self.columns]
        shown = [
            "  ".join(
                f"{cell:<{w}}" if word else f"{cell:>{w}}" for cell, w, word in zip(line, widths, is_word, strict=True)
            )
            for line in lines
        ]
        rule = "  ".join("-" * width for width in widths)
        told = [textwrap.fill(each, max(_NARROWEST, len(rule)), subsequent_indent="  ") for each in self.definitions]
        return "\n".join(line.rstrip() for line in (shown[0], rule, *shown[1:], "", *told)) + "\n"


_NARROWEST = 80
"""Characters in a line of the definitions, where the table has not more."""

_WORDS = ("Scenario", "Agent")

_C, _S_PLANNED, _S_EXECUTED = "C", "S (planned)", "S (executed)"

_FRAMES = "C (frames)"


def results_table(comparisons: Sequence[DriveComparison]) -> ResultsTable:
    """Make the table. Rows of several seeds have means, with 95 % bootstrap intervals in brackets."""
    has_seeds = any(len(weather.runs) > 1 for each in comparisons for weather in each.weathers)
    columns = (*_WORDS, "R (mm/h)", "Coll.", "Min. TTC (s)", _C, _FRAMES, _S_PLANNED, _S_EXECUTED)
    rows = [
        (each.scenario, each.agent, *_cells(weather, has_seeds)) for each in comparisons for weather in each.weathers
    ]
    return ResultsTable(columns, tuple(rows), _definitions(comparisons, has_seeds))


def _cells(weather: IntensityRuns, has_seeds: bool) -> tuple[str, ...]:
    rain = "Clear" if weather.intensity_mm_h == 0 else f"{weather.intensity_mm_h:g}"
    hits = weather.collisions
    collided = f"{hits} of {len(weather.runs)}" if has_seeds else ("Yes" if hits else "No")
    return (
        rain,
        collided,
        _number(weather.mean("min_ttc_s")),
        _percent(weather.mean("planned_point_collision_rate", without_collision=True)),
        _percent(weather.mean("planned_frame_collision_rate_hugsim", without_collision=True)),
        _number(weather.mean("comfort_planned", without_collision=True)),
        _number(weather.mean("comfort_executed", without_collision=True)),
    )


def _number(value: MeanInterval | None) -> str:
    if value is None:
        return NOT_MEASURED
    return f"{value.mean:.3f}" if value.low == value.high else f"{value.mean:.3f} ({value.low:.3f}..{value.high:.3f})"


def _percent(value: MeanInterval | None) -> str:
    if value is None:
        return NOT_MEASURED
    mean, low, high = (100 * each for each in value)
    return f"{mean:.1f} %" if low == high else f"{mean:.1f} ({low:.1f}..{high:.1f}) %"


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


def _plain(cell: str) -> str:
    return escape_invisible(cell).replace("|", "\\|")
