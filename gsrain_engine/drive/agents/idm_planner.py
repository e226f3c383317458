"""Speeds along the route: comfortable behind a lead, as hard on the brake as it takes where comfort is not enough."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from .agent import SPACING_S
from .lane_path import LanePath
from .leads.lead import Lead

_POINTS = 6
_SUBSTEPS = 10
_STANDS_M_S = 0.1
"""Slower is standing."""


@dataclass(frozen=True, slots=True)
class IDMPlanner:
    """The intelligent driver model (Treiber, Hennecke and Helbing 2000) with emergency braking.

    Gaps are about those of its paper (2 m and 1.6 s); it accelerates and brakes more briskly than there (0.73 and
    1.67 m/s2), as in town, and within the limits of nuPlan's comfort metric (2.40 and 4.05 m/s2).
    """

    cruise_m_s: float
    """Speed on a free road."""
    standstill_gap_m: float = 2.0
    time_gap_s: float = 1.5
    acceleration_m_s2: float = 1.5
    braking_m_s2: float = 2.0
    most_comfortable_m_s2: float = 3.0
    """The model alone does not brake harder."""
    hard_m_s2: float = 8.0
    """What the brakes can do."""
    hard_reserve: float = 1.25
    """An emergency brakes so many times harder than a stop short of the lead takes: the gap may be overestimated."""
    hard_gap_m: float = 1.0
    """What an emergency stop leaves."""
    hard_time_s: float = 0.8
    """Nearer in time, only full braking is left. The model stops with twice that to spare."""
    creep_m: float = 1.5
    """Who stands behind somebody who stands does not set off for less than this much room more."""

    def points(self, path: LanePath, lead: Lead | None) -> Float64[np.ndarray, "6 2"]:
        """Return where to be 0.5 s, 1 s, ..., 3 s from now, in the vehicle's frame (x forward, y left)."""
        return path.points(self.distances(path.state.speed_m_s, lead))

    def distances(self, speed_m_s: float, lead: Lead | None) -> Float64[np.ndarray, "6"]:
        """Return the way made 0.5 s, 1 s, ..., 3 s from now; the lead keeps its speed. Never falls."""
        step_s = SPACING_S / _SUBSTEPS
        speed, way = max(speed_m_s, 0.0), 0.0
        ways: list[float] = []
        for step in range(_POINTS * _SUBSTEPS):
            there = lead and Lead(lead.gap_m + lead.speed_m_s * step * step_s - way, lead.speed_m_s)
            acceleration = self.acceleration(speed, there)
            if speed + acceleration * step_s <= 0:
                way += 0.5 * speed * speed / -acceleration if speed > 0 else 0.0
                speed = 0.0
            else:
                way += (speed + 0.5 * acceleration * step_s) * step_s
                speed += acceleration * step_s
            if (step + 1) % _SUBSTEPS == 0:
                ways.append(way)
        return np.array(ways)

    def acceleration(self, speed_m_s: float, lead: Lead | None) -> float:
        """Return the acceleration (m/s2) that a speed and a lead ask for at a moment."""
        free = self.acceleration_m_s2 * (1 - (speed_m_s / self.cruise_m_s) ** 4)
        if lead is None:
            return max(free, -self.most_comfortable_m_s2)
        stands = speed_m_s < _STANDS_M_S and lead.speed_m_s < 5 * _STANDS_M_S
        if stands and lead.gap_m < self.standstill_gap_m + self.creep_m:
            return -self.most_comfortable_m_s2
        return min(self._follow(speed_m_s, lead, free), -self._hard(speed_m_s, lead))

    def _follow(self, speed_m_s: float, lead: Lead, free_m_s2: float) -> float:
        """The model: the gap that is wanted grows with the speed and with the speed of closing in."""
        closing = speed_m_s - lead.speed_m_s
        moving = speed_m_s * closing / (2 * np.sqrt(self.acceleration_m_s2 * self.braking_m_s2))
        wanted = self.standstill_gap_m + max(0.0, speed_m_s * self.time_gap_s + float(moving))
        share = wanted / max(lead.gap_m, 0.1)
        return max(free_m_s2 - self.acceleration_m_s2 * share * share, -self.most_comfortable_m_s2)

    def _hard(self, speed_m_s: float, lead: Lead) -> float:
        """Braking that an emergency takes; minus infinity where there is none."""
        closing = speed_m_s - lead.speed_m_s
        if closing <= 0:
            return -np.inf
        if lead.gap_m <= closing * self.hard_time_s or lead.gap_m <= self.hard_gap_m:
            return self.hard_m_s2
        needed = closing * closing / (2 * (lead.gap_m - self.hard_gap_m))
        return min(self.hard_reserve * needed, self.hard_m_s2) if needed > self.most_comfortable_m_s2 else -np.inf


def cruise_speed(first_m_s: float) -> float:
    """Return the speed of a free road for a drive that begins at a speed: that one, from standstill 10 m/s."""
    return first_m_s if first_m_s >= 1.0 else 10.0
