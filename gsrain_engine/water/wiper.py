"""Windshield wiper: modes, duty cycle, and the arc of its blade on the pane."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

WiperMode = Literal["off", "interval", "low", "high", "auto"]

LOW_CYCLE_S, HIGH_CYCLE_S = 60 / 45, 60 / 65
"""Time of a sweep out and home. FMVSS 104 asks for at least 45 and 20 cycles a minute, 15 apart; 65 is common."""

INTERVAL_S = 5.0
"""Time from one sweep to the next in `interval`."""

SENSOR_DEPTH_M = 20e-6
"""Mean depth of new water at which the rain sensor of `auto` starts a sweep."""

PIVOT_M = (-0.15, -0.6)
"""Axis of the wiper in pane coordinates."""

INNER_M, OUTER_M = 0.12, 0.72
"""Radii between which the blade wipes."""

PARK_RAD, SWEEP_RAD = np.radians(2.0), np.radians(118.0)
"""Angle of the parked blade from the pane's first axis, and the angle of a sweep."""

BLADE_M = 0.012  # width


@dataclass(slots=True)
class Wiper:
    """State of a wiper; it advances in steps of equal duration."""

    mode: WiperMode
    _phase: float = 1.0
    """Part of the present sweep, 0..1; 1 is parked."""
    _cycle_s: float = LOW_CYCLE_S
    _since_s: float = 0.0
    """Time since the present sweep began."""
    _water_m: float = 0.0
    """Water that has landed since then, as a mean depth."""
    sweeps: int = 0

    @property
    def angle_rad(self) -> float:
        return float(PARK_RAD + SWEEP_RAD * (0.5 - 0.5 * np.cos(2 * np.pi * self._phase)))

    @property
    def is_moving(self) -> bool:
        return self._phase < 1

    def advance(self, step_s: float, water_m: float, home_in_s: float = math.inf) -> tuple[float, float]:
        """Advance by a step in which water of a mean depth lands; returns the blade's angles before and after it.

        At the end of the step, wet glass is swept last so that the blade is at home after `home_in_s`.
        """
        before = self.angle_rad
        self._since_s += step_s
        self._water_m += water_m
        if self._phase < 1:
            self._phase = min(self._phase + step_s / self._cycle_s, 1.0)
        last_s = LOW_CYCLE_S + step_s
        is_last = self.mode != "off" and self._water_m > 0 and last_s <= home_in_s < last_s + step_s
        if self._phase >= 1 and (is_last or (self._is_due() and home_in_s >= 2 * last_s + step_s)):
            rate_m_s = self._water_m / max(self._since_s, 1e-9)
            is_fast = self.mode == "high" or (self.mode == "auto" and rate_m_s * LOW_CYCLE_S > 2 * SENSOR_DEPTH_M)
            self._cycle_s = HIGH_CYCLE_S if is_fast and not is_last else LOW_CYCLE_S
            self._phase = self._since_s = self._water_m = 0.0
            self.sweeps += 1
        return before, self.angle_rad

    def _is_due(self) -> bool:
        if self.mode == "interval":
            return self._since_s >= INTERVAL_S
        return self.mode in ("low", "high") or (self.mode == "auto" and self._water_m >= SENSOR_DEPTH_M)
