"""How long and how fast a camera path is, and where no vehicle could follow it. World frame, metres."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from .camera_path import CameraPath

FASTEST_KM_H = 250.0
"""Faster than cars are let go on any road."""
FASTEST_TURN_DEG_S = 180.0
"""Half a turn a second: a picture that only smears."""
_SAMPLES_A_SECOND, _FEWEST, _MOST = 30, 64, 4000


@dataclass(frozen=True, slots=True, eq=False)
class PathSpeed:
    """A path's speed over its time."""

    times_s: Float64[np.ndarray, " t"]
    speeds_m_s: Float64[np.ndarray, " t"]
    turns_deg_s: Float64[np.ndarray, " t"]
    """How fast the camera turns its head."""
    length_m: float

    @classmethod
    def of(cls, path: CameraPath) -> "PathSpeed":
        """Sample a path, in the world, about thirty times a second."""
        count = int(np.clip(_SAMPLES_A_SECOND * path.duration_s, _FEWEST, _MOST))
        times = np.linspace(path.start_s, path.end_s, count) if path.duration_s > 0 else np.array([path.start_s])
        inside = np.minimum(times, np.nextafter(path.end_s, -np.inf)) if path.loop else times
        speeds = np.linalg.norm(path.velocities(inside), axis=1)
        length = float(np.linalg.norm(np.diff(path.places(inside), axis=0), axis=1).sum())
        return cls(times, speeds, _turn_rates(path, inside), length)

    @property
    def fastest_km_h(self) -> float:
        return float(3.6 * self.speeds_m_s.max())

    @property
    def mean_km_h(self) -> float:
        """Length over time; 0 for a path that takes no time."""
        span = float(self.times_s[-1] - self.times_s[0])
        return 3.6 * self.length_m / span if span > 0 else 0.0

    @property
    def implausible(self) -> Bool[np.ndarray, " t"]:
        """Samples at which the camera is faster than any road vehicle, or turns too fast to see anything."""
        return (3.6 * self.speeds_m_s > FASTEST_KM_H) | (self.turns_deg_s > FASTEST_TURN_DEG_S)

    @property
    def implausible_spans(self) -> list[tuple[float, float]]:
        edges = np.diff(np.concatenate([[False], self.implausible, [False]]).astype(np.int8))
        starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
        return [(float(self.times_s[a]), float(self.times_s[b])) for a, b in zip(starts, ends, strict=True)]

    @property
    def warning(self) -> str | None:
        """What is implausible, in one sentence; None where nothing is."""
        if self.fastest_km_h > FASTEST_KM_H:
            return f"The camera reaches {self.fastest_km_h:,.0f} km/h: no road vehicle does."
        if self.turns_deg_s.max() > FASTEST_TURN_DEG_S:
            return (
                f"The camera turns by up to {self.turns_deg_s.max():.0f} degrees a second: a picture that only smears."
            )
        return None


def _turn_rates(path: CameraPath, times: Float64[np.ndarray, " t"]) -> Float64[np.ndarray, " t"]:
    """Degrees a second, from sample to sample."""
    if len(times) < 2:
        return np.zeros(len(times))
    turns = path.turns(times)
    traces = np.einsum("tij,tij->t", turns[:-1], turns[1:])
    angles = np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1)))
    # arccos of nearly 1 has no more digits than this: what lies below is rounding.
    angles[angles < 1e-5] = 0.0
    rates = angles / np.diff(times)
    return np.append(rates, rates[-1])
