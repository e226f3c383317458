"""Lidar sensor model: beams, detection threshold by range, noise, and sensor presets."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from .settings import SENSOR_NAMES, SensorSettings

STATED_REFLECTANCE = 0.1
"""Makers state the range at which a matt surface of this reflectance is just detected at normal incidence."""


class LidarSensor(SensorSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A pulsed lidar. Power is relative to the detection threshold, without absolute units.

    A surface that fills the beam returns P = P0 rho cos / r^2 exp(-2 beta r) (the lidar equation; Rasshofer, Spies and
    Spies 2011, Advances in Radio Science 9, eq. 1-4), and P0 follows from `range_m`.
    """

    def beam_width_m(self, range_m: Float[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
        """Diameter of the beam: sqrt(d0^2 + (divergence r)^2), with uniform intensity inside."""
        return np.hypot(1e-3 * self.beam_mm, 1e-3 * self.divergence_mrad * np.asarray(range_m, np.float64))

    def overlap(self, range_m: Float[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
        """Share of the beam in the receiver's field of view, 0..1 (Rasshofer et al. 2011)."""
        span = max(self.clear_m - self.blind_m, 1e-9)
        return np.clip((np.asarray(range_m, np.float64) - self.blind_m) / span, 0, 1)

    def detectable(self, range_m: Float[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
        """Smallest detected reflectance of a beam-filling target that faces the sensor; infinite where blind."""
        by_distance = STATED_REFLECTANCE * (np.asarray(range_m, np.float64) / self.range_m) ** 2
        overlap = self.overlap(range_m)
        least = np.maximum(by_distance, self.least_reflectance) / np.maximum(overlap, 1e-9)
        return np.where(overlap > 0, least, np.inf)

    def signal(
        self, range_m: Float[np.ndarray, "*n"], reflectance: Float[np.ndarray, "*n"], extinction_per_m: float
    ) -> Float64[np.ndarray, "*n"]:
        """Received power in multiples of the detection threshold; `reflectance` includes the cosine of incidence."""
        through = np.exp(-2 * extinction_per_m * np.asarray(range_m, np.float64))
        return np.asarray(reflectance, np.float64) / self.detectable(range_m) * through

    def range_sigma(self, signal: Float[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
        """Standard deviation of a range in m: inverse to the root of a signal >= 1 (Skolnik; Kilic et al. 2021)."""
        return self.range_sigma_m / np.sqrt(np.asarray(signal, np.float64))


def _generic(name: str, low_deg: float, high_deg: float, rows: int, **values: Any) -> LidarSensor:
    elevations = tuple(float(each) for each in np.linspace(low_deg, high_deg, rows).round(3))
    return LidarSensor(name=name, elevations_deg=elevations, **values)


_GENERIC = (
    _generic("32 beams, 905 nm, 50 m at 10 %", -30.67, 10.67, 32, range_m=50.0, farthest_m=100.0),
    _generic(
        "64 beams, 905 nm, 80 m at 10 %", -24.8, 2.0, 64, range_m=80.0, farthest_m=150.0, divergence_mrad=2.0
    ),
    _generic(
        "128 beams, 905 nm, 200 m at 10 %", -25.0, 15.0, 128, range_m=200.0, farthest_m=300.0, divergence_mrad=1.5,
        beam_mm=15.0,
    ),
    _generic(
        "forward, 80 rows, 1550 nm, 250 m at 10 %", -15.0, 10.0, 80, azimuth_step_deg=0.15, azimuth_limit_deg=60.0,
        wavelength_nm=1550, range_m=250.0, farthest_m=500.0, divergence_mrad=1.0, beam_mm=25.0,
    ),
)  # fmt: skip
SENSORS: dict[str, LidarSensor] = dict(zip(SENSOR_NAMES, _GENERIC, strict=True))
"""Generic sensor classes, by number of beams or wavelength; none is a specific product."""

# Beams of one turn


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """Beams in the world (meters, z up), and their echoes in clear air."""

    time_s: float
    origin_m: Float64[np.ndarray, "3"]
    directions: Float64[np.ndarray, "n 3"]
    """Unit."""
    ranges_m: Float64[np.ndarray, " n"]
    """Infinite without an echo."""
    points_m: Float32[np.ndarray, "n 3"]
    """Hit points; the origin without an echo."""
    reflectances: Float64[np.ndarray, " n"]
    """Reflectance of the hit surface, including the cosine of incidence: 1 is white and matt at normal incidence."""
    road_cosines: Float64[np.ndarray, " n"]
    """Cosine of incidence on the road; 0 for other surfaces."""
    untouched: Bool[np.ndarray, " n"]
    """Echoes unaffected by rain: of the own vehicle, and placeholders for beams without an echo."""
    intensities: Float32[np.ndarray, " n"] | None = None
    """As in the dataset."""
    full_intensity: float = 1.0
    """Intensity of a white, matt surface at normal incidence."""

    def __len__(self) -> int:
        return len(self.ranges_m)

    @property
    def is_echo(self) -> Bool[np.ndarray, " n"]:
        """Mask of the beams with an echo in clear air that rain can affect."""
        return np.isfinite(self.ranges_m) & ~self.untouched

    def heard_by(self, sensor: LidarSensor) -> "Beams":
        """Return the beams with only those echoes that a sensor detects in clear air."""
        echo = self.is_echo
        signal = sensor.signal(np.where(echo, self.ranges_m, 1.0), self.reflectances, 0.0)
        lost = echo & ((signal < 1) | (self.ranges_m > sensor.farthest_m))
        points = np.where(lost[:, None], self.origin_m.astype(np.float32), self.points_m)
        return replace(self, ranges_m=np.where(lost, np.inf, self.ranges_m), points_m=points)
