"""A roll-out that is open in the window, with its curves and metrics."""

from dataclasses import dataclass
from pathlib import Path

import msgspec

from gsrain_engine.drive.metrics.summary import DriveMetrics, measured
from gsrain_engine.drive.rollouts.files import read_any_rollout
from gsrain_engine.drive.rollouts.rollout import Rollout
from gsrain_engine.drive.rollouts.run_setting import run_setting
from gsrain_engine.untrusted.limits import read_file

from .curves import Curves, curves_of

METRICS_SUFFIX = ".metrics.json"
"""Metrics stand beside a roll-out of a job: they were measured against its scene's background too."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenedRollout:
    """A finished drive and what panels say about it."""

    rollout: Rollout
    curves: Curves
    metrics: DriveMetrics
    path: Path | None
    """File that a person knows; none for the result of a job that was not saved."""
    intensity_mm_h: float

    @property
    def title(self) -> str:
        """Scenario, intensity and agent in a few words."""
        return f"{self.metrics.scenario or 'drive'}, {self.intensity_mm_h:g} mm/h, {self.rollout.agent}"

    @property
    def collision_s(self) -> float | None:
        """When something was hit; None where nothing was."""
        return self.metrics.collision_time_s

    @property
    def duration_s(self) -> float:
        """From the first moment to the last."""
        return self.rollout.steps[-1].time_s

    def saved_at(self, path: Path) -> "OpenedRollout":
        """Return the same with a file of its own."""
        return OpenedRollout(self.rollout, self.curves, self.metrics, path, self.intensity_mm_h)


def open_rollout(path: Path, *, is_own: bool = True) -> OpenedRollout:
    """Read a roll-out; `is_own` says whether the file stays where it is.

    Raises:
        ValueError: For what is no roll-out, naming the file and the line.
        OSError: When the file can't be read.
    """
    rollout = read_any_rollout(path)
    beside = path.with_suffix(METRICS_SUFFIX)
    try:
        metrics = measured(rollout) if is_own else msgspec.json.decode(read_file(beside), type=DriveMetrics)
        curves = curves_of(rollout)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    intensity = run_setting(rollout).intensity_mm_h
    return OpenedRollout(rollout, curves, metrics, path if is_own else None, intensity)
