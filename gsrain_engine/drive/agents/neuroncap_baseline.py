"""NeuroNCAP's baseline (Ljungbergh et al. 2024): on as fast as now, and a full stop where anybody is in the way."""

import numpy as np

from .agent import Needs, Plan
from .constant_velocity import ConstantVelocityAgent
from .observation import Observation, Rig

_HALF_WIDTH_M, _START_M, _AHEAD_S = 2.5, 2.0, 2.0
_STOP = np.zeros((6, 2))


class NeuroNCAPBaselineAgent:
    """Keeps its speed along the route until the middle of somebody is in the corridor ahead; then it wants to stand.

    The corridor is straight, 5 m wide, and reaches from 2 m ahead of the rear axle two seconds of driving further; from
    the first stop on it keeps the length that it then had. It takes road users from the simulator, as the original
    takes them from the model under test.
    """

    name = "neuroncap-baseline"
    needs = Needs()

    def __init__(self) -> None:
        self._onward = ConstantVelocityAgent()
        self._length_m: float | None = None

    def reset(self, seed: int, rig: Rig) -> None:
        self._onward.reset(seed, rig)
        self._length_m = None

    def plan(self, observation: Observation) -> Plan:
        """Return points along the route, or six times the present place."""
        state = observation.state
        length = _AHEAD_S * state.speed_m_s if self._length_m is None else self._length_m
        middles = np.array([(user.x_m, user.y_m) for user in observation.road_users]).reshape(-1, 2)
        ahead, left = state.from_world(middles).T
        inside = (ahead >= _START_M) & (ahead <= _START_M + length) & (np.abs(left) <= _HALF_WIDTH_M)
        blocking = [user.id for user, each in zip(observation.road_users, inside, strict=True) if each]
        if not blocking:
            return Plan(self._onward.plan(observation).points, {"in_corridor": []})
        self._length_m = length
        return Plan(_STOP.copy(), {"in_corridor": blocking})

    def close(self) -> None:
        """Nothing is held."""
