"""Numbers of runs over time: of each run, and over the seeds of one weather as a mean with its band."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float64

from gsrain_engine.evaluate.mean_interval import MeanInterval, mean_interval

from ..rollouts.rollout import Rollout
from .comparison import WeatherRuns
from .time_to_collision import gaps_m, times_to_collision_s

Quantity = Literal["speed_m_s", "acceleration_m_s2", "ttc_s", "gap_m"]


class CurveBand(NamedTuple):
    """A number over time, NaN where it is not known."""

    times_s: Float64[np.ndarray, " n"]
    mean: Float64[np.ndarray, " n"]
    """Over the runs that go on at that time."""
    low: Float64[np.ndarray, " n"]
    """Ends of its 95 % bootstrap interval."""
    high: Float64[np.ndarray, " n"]


def curve(rollout: Rollout, quantity: Quantity) -> Float64[np.ndarray, " n"]:
    """Return a number of a run at its moments; the acceleration is that over the step before, NaN is none."""
    if quantity == "ttc_s":
        return times_to_collision_s(rollout)
    if quantity == "gap_m":
        gaps = gaps_m(rollout)
        return np.where(np.isfinite(gaps), gaps, np.nan)
    values = np.array([getattr(each.ego, quantity) for each in rollout.steps], np.float64)
    if quantity == "acceleration_m_s2":
        values[0] = np.nan  # there is no step before
    return values


def band(weather: WeatherRuns, quantity: Quantity) -> CurveBand:
    """Return a number's mean and band over the runs of one weather, at the times of the longest.

    Of one run the band is the run itself. Raises ValueError where no run has its roll-out, and for steps that differ.
    """
    rollouts = [run.rollout for run in weather.runs if run.rollout is not None]
    if not rollouts:
        raise ValueError(f"the runs at {weather.intensity_mm_h:g} mm/h have no roll-outs to be drawn over time")
    steps = sorted({each.step_s for each in rollouts})
    if len(steps) > 1:
        raise ValueError(f"runs in steps of {steps[0]:g} s and of {steps[-1]:g} s have no common curve")
    longest = max(rollouts, key=lambda each: len(each.steps))
    times = np.array([each.time_s for each in longest.steps])
    table = np.full((len(rollouts), len(times)), np.nan)
    for row, rollout in zip(table, rollouts, strict=True):
        row[: len(rollout.steps)] = curve(rollout, quantity)
    columns = [_interval(column[np.isfinite(column)].tolist()) for column in table.T]
    mean, low, high = (np.array(each) for each in zip(*columns, strict=True))
    return CurveBand(times, mean, low, high)


def _interval(values: Sequence[float]) -> MeanInterval:
    return mean_interval(values) if values else MeanInterval(np.nan, np.nan, np.nan)
