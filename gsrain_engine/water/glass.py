"""Water on glass over time: from rain, pane and the camera's past path to the drops at a time."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from ..rain.air import profile
from ..rain.simulation import RainSimulation
from .glass_drops import GRAVITY_M_S2, TICK_S, GlassDrops, Impacts, Wetting, impacts_on
from .pane import Pane
from .spray import SprayParcels, pane_flux_m_s
from .wiper import Wiper, WiperMode

_TICKS = 10
"""Ticks for which the camera's motion and the rain are those at the first of them."""

_HEIGHT_M = 1.3  # of a windshield above the road, for the wind
_EPOCH_S = 600.0
"""Time after which the past begins anew, so that a late frame needs no endless replay."""


class CameraMotion(NamedTuple):
    """Orientation and velocity of a camera at a time, in the world."""

    camera_to_world: Float64[np.ndarray, "3 3"]
    velocity_m_s: Float64[np.ndarray, "3"]
    position_m: Float64[np.ndarray, "3"] | None = None
    """Place in the world; without it no spray lands."""


PastMotion = Callable[[float], CameraMotion]
"""Motion of a camera at any time up to that of the frame."""

PastSpray = Callable[[float], SprayParcels]
"""Spray of vehicles at any time up to that of the frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GlassState:
    """Figures of the water on a pane at a time."""

    impacts: int
    expected_impacts: float
    """Integral of the flux through the moving pane."""
    seconds: float
    """Duration of the replayed past."""
    area_m2: float
    """Simulated part of the pane: the camera's view of it."""


class GlassHistory:
    """Water on one pane over time. The state at a time is a function of that time: it is the same for any order."""

    def __init__(
        self,
        pane: Pane,
        rainfall: RainSimulation,
        past: PastMotion,
        *,
        contact_angle_deg: float,
        wet_s: float,
        wiper: WiperMode,
    ) -> None:
        """Describe a pane that is dry `wet_s` before time 0 (and before each further 10 minutes)."""
        self.pane, self.past = pane, past
        self.spray: PastSpray | None = None
        self._rainfall, self._wet_s = rainfall, wet_s
        self._wetting = Wetting(contact_angle_deg)
        self._mode: WiperMode = wiper if pane.kind == "windshield" else "off"
        self._epoch: int | None = None
        self._tick = self._first = 0
        self._impacts: Impacts | None = None
        self._forces = np.zeros(2), np.zeros(2)
        self._expected = self._spray_m_s = 0.0
        self.drops, self.wiper = GlassDrops(pane, self._wetting, 0), Wiper(self._mode)

    def at(self, time_s: float) -> GlassState:
        """Advance to a time, or replay the past if it lies before the present state; returns the figures."""
        epoch = max(int(time_s // _EPOCH_S), 0)
        first = round((epoch * _EPOCH_S - self._wet_s) / TICK_S)
        goal = max(int(np.floor(time_s / TICK_S + 1e-6)), first)
        if epoch != self._epoch or goal < self._tick:
            self.drops = GlassDrops(self.pane, self._wetting, self._rainfall.rain.seed)
            self.wiper = Wiper(self._mode)
            self._epoch, self._tick, self._first, self._expected = epoch, first, first, 0.0
            self._impacts = None
        while self._tick < goal:
            part = (self._tick - first) % _TICKS
            if part == 0 or self._impacts is None:
                self._look(self._tick * TICK_S)
            self._step(min(1 if self._spray_m_s > 0 else _TICKS - part, goal - self._tick))
        return GlassState(
            impacts=self.drops.impacts,
            expected_impacts=self._expected,
            seconds=(self._tick - first) * TICK_S,
            area_m2=self.pane.area_m2,
        )

    def _look(self, time_s: float) -> None:
        """Take the rain and the motion at a time."""
        now, (turn, velocity, place) = self._rainfall.frozen_at(time_s), self.past(time_s)
        motion = now.motion
        share = float(profile(np.array([_HEIGHT_M]), motion.wind.roughness_m)[0])
        wind = share * motion.wind.mean_m_s[0], share * motion.wind.mean_m_s[1]
        self._impacts = impacts_on(
            self.pane, turn, velocity, wind, now.state.density_m3, now.diameters_mm, motion.fall_speed_m_s
        )
        axes = turn @ np.stack([self.pane.right, self.pane.up], axis=1)
        self._forces = np.array([0.0, 0.0, -GRAVITY_M_S2]) @ axes, (np.array([*wind, 0.0]) - velocity) @ axes
        self._spray_m_s = 0.0
        if self.spray is not None and place is not None:
            middle = place + turn @ self.pane.center_m
            self._spray_m_s = pane_flux_m_s(self.spray(time_s), middle, turn @ self.pane.normal, velocity)

    def _step(self, ticks: int) -> None:
        assert self._impacts is not None
        water_m = (self._impacts.water_m_s + self._spray_m_s) * TICK_S
        if self._spray_m_s > 0:  # lands tick by tick, whatever the steps
            self.drops.add_film(self._spray_m_s * TICK_S)
        blade = np.array([self.wiper.advance(TICK_S, water_m) for _ in range(ticks)])
        self.drops.advance(self._tick, self._impacts, *self._forces, blade)
        self._expected += self._impacts.rate_s * TICK_S * ticks
        self._tick += ticks
