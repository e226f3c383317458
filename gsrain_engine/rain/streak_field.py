"""The drops of one moment around one camera: everything from which a kernel or a shader makes their streaks."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from .drop_field import Culling, Drops, Offsets, count_in_region, find_drops, find_in_region
from .rain import Rain
from .roofs import Roofs
from .streaks import Shutter, Streaks
from .visible_streaks import make_visible_streaks


@dataclass(frozen=True, slots=True, eq=False)
class StreakField:
    """A periodic cell of drops, and the shutter through which they are seen. World frame, metres."""

    rain: Rain
    count: int
    """Drops with numbers below this exist."""
    where: Offsets
    period_m: Float64[np.ndarray, "3"]
    """Edges of the cell."""
    axes: Float64[np.ndarray, "3 3"]
    """Cell to world, a rotation."""
    center_m: Float64[np.ndarray, "3"]
    """Centre of the cell, and of the streak region, in the world."""
    culling: Culling
    diameters_mm: Float64[np.ndarray, " classes"]
    wind_m_s: Float64[np.ndarray, "2"]
    """Along world x and y."""
    fall_speed_m_s: Float64[np.ndarray, " classes"]
    shutter: Shutter
    roofs: Roofs | None = None
    """Those over the cell; none where it is in the open."""

    def drops(self) -> Drops:
        """Drops that the camera may see."""
        return self._in_the_open(find_drops(self.count, self.rain.seed, self.where, self.period_m, self.culling))

    def region_drops(self) -> Drops:
        """Drops in the streak region, seen or not: what other sensors than the camera meet."""
        return self._in_the_open(find_in_region(self.count, self.rain.seed, self.where, self.period_m, self.culling))

    def _in_the_open(self, found: Drops) -> Drops:
        if self.roofs is None:
            return found
        kept = ~self.roofs.shelter(self.positions(found))
        return Drops(found.numbers[kept], found.class_index[kept], found.fractions[kept])

    def drops_in_region(self) -> int:
        """Count the drops in the streak region, seen or not, under roofs too."""
        return count_in_region(self.count, self.rain.seed, self.where, self.period_m, self.culling)

    def positions(self, drops: Drops) -> Float64[np.ndarray, "m 3"]:
        """Positions in the world."""
        return drops.positions(self.period_m) @ self.axes.T + self.center_m

    def streaks(self, drops: Drops) -> Streaks:
        """Turn drops into streak Gaussians in the world."""
        c = drops.class_index
        return make_visible_streaks(
            self.positions(drops), self.diameters_mm[c], self.velocities(c), self.shutter, self.rain
        )

    def velocities(self, class_index: Int64[np.ndarray, " m"]) -> Float64[np.ndarray, "m 3"]:
        """World velocities of drops of some classes in m/s."""
        velocities = np.empty((len(class_index), 3))
        velocities[:, :2] = self.wind_m_s
        velocities[:, 2] = -self.fall_speed_m_s[class_index]
        return velocities

    @property
    def most_drops(self) -> int:
        """More drops than the camera can see but by a chance of one in millions: room to reserve for them."""
        left, right, top, bottom = np.abs(self.culling.slopes)
        wide, high, far, margin = left + right, top + bottom, self.culling.class_far_m, self.culling.class_margin_m
        volume = wide * high * far**3 / 3 + margin * (wide + high) * far**2 + 4 * margin**2 * far
        expected = self.count * float(np.mean(np.minimum(volume / np.prod(self.period_m), 1.0)))
        return min(self.count, int(1.1 * expected + 10 * np.sqrt(expected)) + 64)
