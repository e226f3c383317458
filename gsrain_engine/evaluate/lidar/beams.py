"""The beams of one turn of a lidar, and what each hits in clear air."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Float64

from .sensor import LidarSensor


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """Beams in the world (metres, z up), and their echoes in clear air."""

    time_s: float
    origin_m: Float64[np.ndarray, "3"]
    directions: Float64[np.ndarray, "n 3"]
    """Unit."""
    ranges_m: Float64[np.ndarray, " n"]
    """Infinite where nothing comes back."""
    points_m: Float32[np.ndarray, "n 3"]
    """What is hit; the origin where nothing is."""
    reflectances: Float64[np.ndarray, " n"]
    """Of what is hit, with the cosine of incidence in it: 1 is white, matt and square to the beam."""
    road_cosines: Float64[np.ndarray, " n"]
    """Cosine of incidence on the road; 0 for what is not the road."""
    untouched: Bool[np.ndarray, " n"]
    """Echoes that rain leaves alone: of the own vehicle, and placeholders for beams without one."""
    intensities: Float32[np.ndarray, " n"] | None = None
    """As the data set has them."""
    full_intensity: float = 1.0
    """Intensity of what is white, matt and square to the beam."""

    def __len__(self) -> int:
        return len(self.ranges_m)

    @property
    def is_echo(self) -> Bool[np.ndarray, " n"]:
        """Which beams come back in clear air, less those that rain leaves alone."""
        return np.isfinite(self.ranges_m) & ~self.untouched

    def heard_by(self, sensor: LidarSensor) -> "Beams":
        """Return the beams with those echoes alone that a sensor detects in clear air."""
        echo = self.is_echo
        signal = sensor.signal(np.where(echo, self.ranges_m, 1.0), self.reflectances, 0.0)
        lost = echo & ((signal < 1) | (self.ranges_m > sensor.farthest_m))
        points = np.where(lost[:, None], self.origin_m.astype(np.float32), self.points_m)
        return replace(self, ranges_m=np.where(lost, np.inf, self.ranges_m), points_m=points)
