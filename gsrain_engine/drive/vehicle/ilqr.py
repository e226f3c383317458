"""The iLQR tracker: finds the inputs that keep a bicycle nearest to a plan, by repeated linear-quadratic regulation."""

import numpy as np
from jaxtyping import Float64

from .controller_settings import ControllerSettings
from .reachable_plan import reachable
from .state import Control, VehicleState
from .tracked_plan import tracked_states
from .tracker_kernels import INPUTS, STATES, improved, policy, rolled_out
from .vehicle import Vehicle
from .warm_start import first_inputs

_WEIGHTS = np.array([1, 1, 10, 0, 0, 1, 10, *[1] * STATES, *[1] * INPUTS], np.float64)
"""Of errors of x, y, heading, speed, steering; of acceleration and steering rate; of the trust region."""
_TOLERANCE = 1e-6
"""A smaller change of all inputs together ends the search."""


class ILQRTracker:
    """nuPlan's tracker (Karnchanachari et al. 2024; iLQR: Li and Todorov 2004), which HUGSIM steers with.

    It minimizes squared errors of place and heading (10 times) at the plan's points, and squared accelerations and
    steering rates (10 times), over the bicycle in steps of the plan's spacing; deviations from the iterate before are
    penalized as a trust region. Only the first input is used. The search ends by its own convergence or after a count
    of iterations: nuPlan's limit of 50 ms by the clock would make results depend on the machine.

    With the heading reference "hugsim" all else is as published. With "tangent" two things are mended. The steps are
    taken by the midpoint: Euler's, half a second long, drive a circle of 20 m at 5 m/s 0.65 m too far inside. And a
    plan that stops sooner than the vehicle can is braked for along its own line: the published tracker comes nearer to
    points that it has passed by steering away as far as it can.
    """

    def __init__(self, settings: ControllerSettings) -> None:
        """Take limits, iterations and the heading that is wanted from a scenario's settings."""
        self._settings = settings

    def reset(self) -> None:
        """Forget nothing: each search starts from its plan."""

    def control(
        self, vehicle: Vehicle, state: VehicleState, plan: Float64[np.ndarray, "n 2"], spacing_s: float
    ) -> Control:
        if self._settings.heading_reference == "hugsim":
            return _first(self.inputs(vehicle, state, plan, spacing_s))
        braking = float(self._limits(vehicle)[0])
        points, full_braking = reachable(plan, state.speed_m_s, braking, spacing_s)
        control = _first(self.inputs(vehicle, state, points, spacing_s))
        return Control(-braking, control.steer_rate_rad_s) if full_braking else control

    def inputs(
        self, vehicle: Vehicle, state: VehicleState, plan: Float64[np.ndarray, "n 2"], spacing_s: float
    ) -> Float64[np.ndarray, "n 2"]:
        """Return accelerations (m/s2) and steering rates (rad/s, left positive) over the plan's whole horizon."""
        wanted = tracked_states(plan, self._settings.heading_reference)
        limits, at = self._limits(vehicle), 0.0 if self._settings.heading_reference == "hugsim" else 0.5
        steer = float(np.clip(state.steer_rad, -limits[3], limits[3]))
        start = np.array([0.0, 0.0, 0.0, state.speed_m_s, steer])
        inputs = first_inputs(wanted, state.speed_m_s, steer, vehicle.wheelbase_m, spacing_s)
        states = np.empty((len(wanted), STATES))
        better, offsets = np.empty_like(inputs), np.empty_like(inputs)
        gains = np.empty((len(inputs), INPUTS, STATES))
        rolled_out(start, inputs, spacing_s, at, vehicle.wheelbase_m, limits, states)
        for _ in range(self._settings.iterations):
            policy(states, inputs, wanted, spacing_s, at, vehicle.wheelbase_m, _WEIGHTS, gains, offsets)
            improved(states, inputs, spacing_s, at, vehicle.wheelbase_m, limits, gains, offsets, better)
            change = float(np.sqrt(np.sum((better - inputs) ** 2)))
            inputs, better = better, inputs
            rolled_out(start, inputs, spacing_s, at, vehicle.wheelbase_m, limits, states)
            if change < _TOLERANCE:
                break
        return inputs

    def _limits(self, vehicle: Vehicle) -> Float64[np.ndarray, "4"]:
        settings = self._settings
        return np.array([
            min(settings.most_braking_m_s2, vehicle.most_braking_m_s2),
            min(settings.most_acceleration_m_s2, vehicle.most_acceleration_m_s2),
            vehicle.most_steer_rate_rad_s,
            vehicle.most_steer_rad,
        ])  # fmt: skip


def _first(inputs: Float64[np.ndarray, "n 2"]) -> Control:
    return Control(float(inputs[0, 0]), float(inputs[0, 1]))
