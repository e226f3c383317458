"""Runs side by side: by scenario and agent, in rows by rain intensity, with what varies between seeds."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from gsrain_engine.evaluate.mean_interval import MeanInterval, mean_interval

from ..rollouts.json_lines import write_rollout
from ..rollouts.rollout import Rollout
from .hd_score import DrivableArea
from .planned_collisions import Touchable
from .summary import DriveMetrics, measured


class Run(NamedTuple):
    """A run with its metrics."""

    metrics: DriveMetrics
    rollout: Rollout | None = None
    """What figures over time need; tables do without."""

    @classmethod
    def of(cls, rollout: Rollout, occupied: Touchable | None = None, drivable: DrivableArea | None = None) -> "Run":
        """Measure a roll-out."""
        return cls(measured(rollout, occupied, drivable), rollout)

    def save(self, path: Path | str) -> None:
        """Write the roll-out as JSON lines, which the window plays; raises `ValueError` where there is none."""
        if self.rollout is None:
            raise ValueError(f"{path}: this run has metrics but no roll-out to be written")
        write_rollout(Path(path), self.rollout)


@dataclass(frozen=True, slots=True)
class WeatherRuns:
    """The runs of one scenario and agent in rain of one intensity."""

    intensity_mm_h: float
    runs: tuple[Run, ...]
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
class Comparison:
    """One scenario driven by one agent, in several weathers."""

    scenario: str
    agent: str
    scene: str
    weathers: tuple[WeatherRuns, ...]
    """By intensity, the clear one first."""

    @property
    def title(self) -> str:
        return f"{self.scenario}, {self.agent}"

    @property
    def runs(self) -> tuple[Run, ...]:
        return tuple(run for weather in self.weathers for run in weather.runs)


def compare(runs: Iterable[Run]) -> tuple[Comparison, ...]:
    """Group runs by scenario, agent and scene, as they first come; in each by intensity, then by seed."""
    groups: dict[tuple[str, str, str], list[Run]] = {}
    for run in runs:
        groups.setdefault((run.metrics.scenario, run.metrics.agent, run.metrics.scene), []).append(run)
    return tuple(Comparison(*key, _by_weather(own)) for key, own in groups.items())


def _by_weather(runs: list[Run]) -> tuple[WeatherRuns, ...]:
    by_intensity: dict[float, list[Run]] = {}
    for run in sorted(runs, key=lambda each: (each.metrics.intensity_mm_h, each.metrics.seed)):
        by_intensity.setdefault(run.metrics.intensity_mm_h, []).append(run)
    return tuple(WeatherRuns(intensity, tuple(own)) for intensity, own in by_intensity.items())
