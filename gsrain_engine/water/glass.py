"""Water on glass over time: from rain, pane and the camera's past path to the drops at a time."""

import copy
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from ..rain.air import profile
from ..rain.simulation import RainSimulation
from ..scene.gaussians import IdentityKey
from .glass_drops import GRAVITY_M_S2, TICK_S, GlassDrops, Impacts, Wetting, impacts_on
from .pane import Pane
from .spray import SprayParcels, pane_flux_m_s
from .wiper import Wiper, WiperMode

_TICKS = 10
"""Ticks for which the camera's motion and the rain are those at the first of them."""

_HEIGHT_M = 1.3  # of a windshield above the road, for the wind
_EPOCH_TICKS = 6000
"""Time after which the past begins anew, so that a late frame needs no long replay: the covered area of a pane is
steady after 20 to 40 s. A wiper that is on has just swept it then, so that what it wipes goes on as before."""
_SAVED_TICKS, _MAX_SAVED = 200, 40
"""Time between states that are saved, to go back to, and their greatest number."""


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


class _SavedState(NamedTuple):
    drops: GlassDrops
    wiper: Wiper
    expected: float
    motion: CameraMotion
    """Of the camera at that time: another past may have another one."""


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
        """Describe a pane that is dry `wet_s` before time 0, and before each further minute for what follows."""
        self.pane, self.past = pane, past
        self.spray: PastSpray | None = None
        self._rainfall, self._wet_s = rainfall, wet_s
        self._wetting = Wetting(contact_angle_deg)
        self._mode: WiperMode = wiper if pane.kind == "windshield" else "off"
        self._epoch: int | None = None
        self._tick = 0
        self._saved: dict[int, _SavedState] = {}
        """By tick, in the order in which they were reached."""
        self.impacts: Impacts | None = None
        """Rain on the pane at this moment."""
        self._impacts_of: Hashable = None
        self._forces = np.zeros(2), np.zeros(2)
        self._expected = self._spray_m_s = 0.0
        self.drops, self.wiper = GlassDrops(pane, self._wetting, 0), Wiper(self._mode)

    def at(self, time_s: float) -> GlassState:
        """Advance to a time, or replay the past if it lies before the present state; returns the figures."""
        goal = int(np.floor(time_s / TICK_S + 1e-6))
        epoch = max(goal // _EPOCH_TICKS, 0)
        first = epoch * _EPOCH_TICKS - round(self._wet_s / TICK_S)
        goal = max(goal, first)
        if epoch != self._epoch:
            self._saved.clear()
        if epoch != self._epoch or goal < self._tick:
            self._epoch = epoch
            tick = self._saved_before(goal)
            if tick is None:
                seed = self._rainfall.rain.seed
                self._start(first, GlassDrops(self.pane, self._wetting, seed), Wiper(self._mode), 0.0)
            else:
                self._start(tick, *copy.deepcopy(self._saved[tick][:3]))
        while self._tick < goal:
            part = (self._tick - first) % _TICKS
            if (self._tick - first) % _SAVED_TICKS == 0 and self._tick not in self._saved:
                self._save()
            if part == 0 or self.impacts is None:
                self._look(self._tick * TICK_S)
            self._step(min(1 if self._spray_m_s > 0 else _TICKS - part, goal - self._tick))
        return GlassState(
            impacts=self.drops.impacts,
            expected_impacts=self._expected,
            seconds=(self._tick - first) * TICK_S,
            area_m2=self.pane.area_m2,
        )

    def _start(self, tick: int, drops: GlassDrops, wiper: Wiper, expected: float) -> None:
        self._tick, self.drops, self.wiper, self._expected, self.impacts = tick, drops, wiper, expected, None

    def _save(self) -> None:
        state = copy.deepcopy((self.drops, self.wiper, self._expected))
        self._saved[self._tick] = _SavedState(*state, self.past(self._tick * TICK_S))
        if len(self._saved) > _MAX_SAVED:  # the first one stays
            self._saved.pop(list(self._saved)[1])

    def _saved_before(self, goal: int) -> int | None:
        """Latest saved tick up to another; states of a past that moved otherwise are forgotten."""
        tick = max((each for each in self._saved if each <= goal), default=None)
        if tick is not None:
            then, now = self._saved[tick].motion, self.past(tick * TICK_S)
            if not all(np.allclose(*pair, atol=1e-6) for pair in zip(then[:2], now[:2], strict=True)):
                self._saved.clear()
                return None
        return tick

    def _look(self, time_s: float) -> None:
        """Take the rain and the motion at a time."""
        now, (turn, velocity, place) = self._rainfall.frozen_at(time_s), self.past(time_s)
        motion = now.motion
        share = float(profile(np.array([_HEIGHT_M]), motion.wind.roughness_m)[0])
        wind = share * motion.wind.mean_m_s[0], share * motion.wind.mean_m_s[1]
        key = turn.tobytes(), velocity.tobytes(), wind, now.state.density_m3, IdentityKey(now.diameters_mm)
        if self.impacts is None or key != self._impacts_of:  # steady rain on a steady camera has the same ones
            self.impacts, self._impacts_of = (
                impacts_on(
                    self.pane, turn, velocity, wind, now.state.density_m3, now.diameters_mm, motion.fall_speed_m_s
                ),
                key,
            )
        axes = turn @ np.stack([self.pane.right, self.pane.up], axis=1)
        self._forces = np.array([0.0, 0.0, -GRAVITY_M_S2]) @ axes, (np.array([*wind, 0.0]) - velocity) @ axes
        self._spray_m_s = 0.0
        if self.spray is not None and place is not None:
            middle = place + turn @ self.pane.center_m
            self._spray_m_s = pane_flux_m_s(self.spray(time_s), middle, turn @ self.pane.normal, velocity)

    def _home_in_s(self, ticks: int) -> float:
        """Time to the end of the epoch in some ticks: no end is the beginning, time 0."""
        tick = self._tick + ticks
        return (_EPOCH_TICKS - tick % _EPOCH_TICKS) * TICK_S if tick > 0 else np.inf

    def _step(self, ticks: int) -> None:
        assert self.impacts is not None
        water_m = (self.impacts.water_m_s + self._spray_m_s) * TICK_S
        if self._spray_m_s > 0:  # lands tick by tick, whatever the steps
            self.drops.add_film(self._spray_m_s * TICK_S)
        blade = np.array([self.wiper.advance(TICK_S, water_m, self._home_in_s(k + 1)) for k in range(ticks)])
        self.drops.advance(self._tick, self.impacts, *self._forces, blade)
        self._expected += self.impacts.rate_s * TICK_S * ticks
        self._tick += ticks
