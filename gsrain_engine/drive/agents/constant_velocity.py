"""The plainest driver: on along the route, as fast as now, whatever comes."""

import numpy as np

from .agent import SPACING_S, Needs, Plan
from .observation import Observation, Rig

_POINTS = 6


class ConstantVelocityAgent:
    """Keeps its speed and its way: what happens where nobody brakes."""

    name = "constant-velocity"
    needs = Needs()

    def reset(self, seed: int, rig: Rig) -> None:
        """Begin a drive."""

    def plan(self, observation: Observation) -> Plan:
        state = observation.state
        along = observation.route.nearest(state.x_m, state.y_m).along_m
        distances = along + state.speed_m_s * SPACING_S * np.arange(1, _POINTS + 1)
        return Plan(state.from_world(np.array([observation.route.at(float(s))[:2] for s in distances])))

    def close(self) -> None:
        """Nothing is held."""
