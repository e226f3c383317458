"""How far the drops of each diameter class have moved: fall, wind and gusts, integrated over time in float64."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

GUST_PERIODS_S = (7.0, 11.3, 18.1)
"""Periods of the sines that a gust is made of: no common multiple within hours."""


@dataclass(frozen=True, eq=False)
class Wind:
    """A mean wind and its slow variation, as a smooth function of (seed, t)."""

    mean_m_s: tuple[float, float] = (0.0, 0.0)
    gust_m_s: float = 0.0
    seed: int = 0

    def velocity(self, time_s: float) -> Float64[np.ndarray, "2"]:
        """Wind along world x and y in m/s."""
        amplitude, rate, phase = self._sines()
        return np.asarray(self.mean_m_s) + np.sum(amplitude * np.sin(rate * time_s + phase), axis=1)

    def displacement(self, time_s: float) -> Float64[np.ndarray, "2"]:
        """Integral of the velocity from 0 to t, in metres."""
        amplitude, rate, phase = self._sines()
        swing = np.sum(amplitude / rate * (np.cos(phase) - np.cos(rate * time_s + phase)), axis=1)
        return np.asarray(self.mean_m_s) * time_s + swing

    def _sines(self) -> tuple[Float64[np.ndarray, "2 3"], Float64[np.ndarray, "3"], Float64[np.ndarray, "2 3"]]:
        phase = np.random.default_rng(self.seed).uniform(0, 2 * np.pi, (2, 3))
        rate = 2 * np.pi / np.array(GUST_PERIODS_S)
        return np.full((2, 3), self.gust_m_s / 3), rate, phase


@dataclass(frozen=True, eq=False)
class DropMotion:
    """Displacement of each class since t = 0: where it stood at `since_s`, and how it moves from then on.

    While nothing changes this is a closed form of t. When a person moves a slider, `changed` starts a new stretch at
    the place that each class has reached, so that no drop jumps.
    """

    wind: Wind
    fall_speed_m_s: Float64[np.ndarray, " classes"]
    """Downward speed of each class."""
    since_s: float = 0.0
    drifted_m: Float64[np.ndarray, "2"] | None = None
    """How far all drops had drifted at `since_s`; none is not at all."""
    fallen_m: Float64[np.ndarray, " classes"] | None = None
    """How far each class had fallen at `since_s`; none is not at all."""

    def displacement(self, time_s: float) -> Float64[np.ndarray, "classes 3"]:
        """World displacement of each class in metres."""
        moved = np.empty((len(self.fall_speed_m_s), 3))
        moved[:, :2] = self.drift(time_s)
        moved[:, 2] = -self.fallen(time_s)
        return moved

    def without_drift(self) -> "DropMotion":
        """Return the same fall from straight above."""
        return replace(self, wind=Wind(), drifted_m=None)

    def drift(self, time_s: float) -> Float64[np.ndarray, "2"]:
        """How far the wind has carried all drops along x and y, in metres."""
        moved = self.wind.displacement(time_s) - self.wind.displacement(self.since_s)
        return moved if self.drifted_m is None else moved + self.drifted_m

    def fallen(self, time_s: float) -> Float64[np.ndarray, " classes"]:
        """How far each class has fallen, in metres."""
        moved = self.fall_speed_m_s * (time_s - self.since_s)
        return moved if self.fallen_m is None else moved + self.fallen_m

    def changed(self, time_s: float, wind: Wind, fall_speed_m_s: Float64[np.ndarray, " classes"]) -> "DropMotion":
        """Go on from where every class is at a time with another wind and other speeds."""
        return DropMotion(wind, fall_speed_m_s, time_s, self.drift(time_s), self.fallen(time_s))
