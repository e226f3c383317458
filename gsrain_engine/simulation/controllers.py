"""iLQR trajectory tracker and the table of controllers."""

from typing import no_type_check

import numpy as np
from jaxtyping import Float64

from ..kernels import kernel
from .controller_base import Controller, PurePursuit, make_reachable, tracked_states
from .geometry import wrap_angle
from .vehicle import Control, Vehicle, VehicleState
from .vehicle_settings import ControllerSettings


class ILQRTracker:
    """nuPlan's tracker (Karnchanachari et al. 2024; iLQR: Li and Todorov 2004), also used by HUGSIM.

    It minimizes squared errors of position and heading (10 times) at the plan's points, and squared accelerations and
    steering rates (10 times), over the bicycle in steps of the plan's spacing; deviations from the previous
    iterate are penalized as a trust region. Only the first input is used. The search ends on convergence or after a
    number of iterations: nuPlan's wall-clock limit of 50 ms would make results depend on the machine.

    With the heading reference "hugsim" everything is as published. "tangent" fixes two defects. Steps use the midpoint
    rule: Euler steps of half a second drive a circle of 20 m at 5 m/s 0.65 m too far inside. And for a plan that stops
    sooner than the vehicle can, the vehicle brakes along the plan's line: the published tracker approaches points that
    it has passed by steering away as far as possible.
    """

    def __init__(self, settings: ControllerSettings) -> None:
        self._settings = settings

    def control(
        self, vehicle: Vehicle, state: VehicleState, plan: Float64[np.ndarray, "n 2"], spacing_s: float
    ) -> Control:
        if self._settings.heading_reference == "hugsim":
            return Control(*self.inputs(vehicle, state, plan, spacing_s)[0].tolist())
        braking = float(self._limits(vehicle)[0])
        points, full_braking = make_reachable(plan, state.speed_m_s, braking, spacing_s)
        acceleration, steer_rate = self.inputs(vehicle, state, points, spacing_s)[0].tolist()
        return Control(-braking if full_braking else acceleration, steer_rate)

    def inputs(
        self, vehicle: Vehicle, state: VehicleState, plan: Float64[np.ndarray, "n 2"], spacing_s: float
    ) -> Float64[np.ndarray, "n 2"]:
        """Return accelerations (m/s2) and steering rates (rad/s, left positive) over the plan's whole horizon."""
        reference = tracked_states(plan, self._settings.heading_reference)
        limits, at = self._limits(vehicle), 0.0 if self._settings.heading_reference == "hugsim" else 0.5
        steer = float(np.clip(state.steer_rad, -limits[3], limits[3]))
        start = np.array([0.0, 0.0, 0.0, state.speed_m_s, steer])
        inputs = first_inputs(reference, state.speed_m_s, steer, vehicle.wheelbase_m, spacing_s)
        states = np.empty((len(reference), STATES))
        better, offsets = np.empty_like(inputs), np.empty_like(inputs)
        gains = np.empty((len(inputs), INPUTS, STATES))
        roll_out(start, inputs, spacing_s, at, vehicle.wheelbase_m, limits, states)
        for _ in range(self._settings.iterations):
            solve_lqr_policy(states, inputs, reference, spacing_s, at, vehicle.wheelbase_m, _WEIGHTS, gains, offsets)
            forward_pass(states, inputs, spacing_s, at, vehicle.wheelbase_m, limits, gains, offsets, better)
            change = float(np.sqrt(np.sum((better - inputs) ** 2)))
            inputs, better = better, inputs
            roll_out(start, inputs, spacing_s, at, vehicle.wheelbase_m, limits, states)
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


def open_controller(settings: ControllerSettings) -> Controller:
    return ILQRTracker(settings) if settings.kind == "ilqr" else PurePursuit()


# iLQR kernels
# States are x, y, heading, speed, steering angle of the front wheels; inputs are acceleration and steering rate. Plain
# loops multiply small matrices, so that results do not depend on the installed BLAS. `at` is the fraction of a step at
# which speed, steering and heading are evaluated: 0 is Euler's rule (nuPlan's), which cuts corners, 0.5 the midpoint.

STATES, INPUTS = 5, 2
_WEIGHTS = np.array([1, 1, 10, 0, 0, 1, 10, *[1] * STATES, *[1] * INPUTS], np.float64)
"""Weights of errors of x, y, heading, speed, steering; of acceleration and steering rate; of the trust region."""

_TOLERANCE = 1e-6  # the search ends when the norm of the input change is smaller
_SLOWEST_M_S = 0.01  # minimum speed for linearization; at standstill steering would have no effect


@kernel()
@no_type_check
def wrap_angle_kernel(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


@kernel()
@no_type_check
def step_state(state, control, dt, at, wheelbase, limits, after):
    """Write the next state to `after`; `control` is clipped to `limits` in place.

    `limits`: maximum braking, acceleration, steering rate, steering angle.
    """
    control[0] = min(max(control[0], -limits[0]), limits[1])
    control[1] = min(max(control[1], -limits[2]), limits[2])
    after[3] = state[3] + control[0] * dt
    after[4] = min(max(state[4] + control[1] * dt, -limits[3]), limits[3])
    control[1] = (after[4] - state[4]) / dt
    speed, steer = state[3] + at * control[0] * dt, state[4] + at * control[1] * dt
    turn = speed * np.tan(steer) / wheelbase * dt
    heading = state[2] + at * turn
    after[0] = state[0] + speed * np.cos(heading) * dt
    after[1] = state[1] + speed * np.sin(heading) * dt
    after[2] = state[2] + turn


@kernel()
@no_type_check
def linearize_dynamics(state, control, dt, at, wheelbase, slope, effect):
    """Write the derivatives of `step_state` by state, (5, 5), and by control within its limits, (5, 2)."""
    speed, steer = state[3] + at * control[0] * dt, state[4] + at * control[1] * dt
    if abs(speed) < _SLOWEST_M_S:
        speed = -_SLOWEST_M_S if speed < 0 else _SLOWEST_M_S
    by_speed, by_steer = np.tan(steer) / wheelbase * dt, speed * dt / (wheelbase * np.cos(steer) ** 2)
    heading = state[2] + at * speed * by_speed
    forward, sideways = np.cos(heading) * dt, np.sin(heading) * dt
    slope[:] = 0.0
    for i in range(STATES):
        slope[i, i] = 1.0
    slope[0, 2], slope[1, 2] = -speed * sideways, speed * forward
    slope[0, 3] = forward - speed * sideways * at * by_speed
    slope[1, 3] = sideways + speed * forward * at * by_speed
    slope[0, 4] = -speed * sideways * at * by_steer
    slope[1, 4] = speed * forward * at * by_steer
    slope[2, 3], slope[2, 4] = by_speed, by_steer
    effect[:] = 0.0
    for i in range(3):
        effect[i, 0], effect[i, 1] = at * dt * slope[i, 3], at * dt * slope[i, 4]
    effect[3, 0] = effect[4, 1] = dt


@kernel()
@no_type_check
def roll_out(start, controls, dt, at, wheelbase, limits, states):
    """Write the states that controls lead to, starting with `start`; `controls` are clipped to the limits."""
    states[0] = start
    for k in range(len(controls)):
        step_state(states[k], controls[k], dt, at, wheelbase, limits, states[k + 1])


@kernel()
@no_type_check
def solve_lqr_policy(states, controls, reference, dt, at, wheelbase, weights, gains, offsets):
    """Write the optimal linear policy for deviations, by dynamic programming backward from the horizon.

    `weights`: of state errors (5), inputs (2), deviations of states (5) and of inputs (2) from the current iterate; the
    last two are the trust region. The policy is `gains[k] @ deviation + offsets[k]`.
    """
    count = len(controls)
    value, slope_of_value = np.zeros((STATES, STATES)), np.zeros(STATES)
    for i in range(STATES):
        value[i, i] = weights[i] + weights[7 + i]
    _add_error(states[count], reference[count], weights, slope_of_value)
    slope, effect = np.empty((STATES, STATES)), np.empty((STATES, INPUTS))
    for k in range(count - 1, -1, -1):
        linearize_dynamics(states[k], controls[k], dt, at, wheelbase, slope, effect)
        _answer(value, slope_of_value, slope, effect, controls[k], weights, gains[k], offsets[k])
        gain, offset = gains[k], offsets[k]
        value, slope_of_value = _before(value, slope_of_value, slope, effect, gain, offset, controls[k], weights)
        _add_error(states[k], reference[k], weights, slope_of_value)


@kernel()
@no_type_check
def forward_pass(states, controls, dt, at, wheelbase, limits, gains, offsets, better):
    """Write the controls of a policy, from the same start."""
    now, deviation, after = states[0].copy(), np.zeros(STATES), np.empty(STATES)
    for k in range(len(controls)):
        for i in range(INPUTS):
            better[k, i] = controls[k, i] + offsets[k, i]
            for j in range(STATES):
                better[k, i] += gains[k, i, j] * deviation[j]
        step_state(now, better[k], dt, at, wheelbase, limits, after)
        now[:] = after
        deviation[:] = after - states[k + 1]


@kernel()
@no_type_check
def _add_error(state, reference, weights, slope_of_value):
    """Add the gradient of one step's tracking cost."""
    for i in range(STATES):
        error = state[i] - reference[i]
        slope_of_value[i] += weights[i] * (wrap_angle_kernel(error) if i == 2 else error)


@kernel()
@no_type_check
def _product(left, right):
    out = np.zeros((left.shape[0], right.shape[1]))
    for i in range(left.shape[0]):
        for m in range(left.shape[1]):
            for j in range(right.shape[1]):
                out[i, j] += left[i, m] * right[m, j]
    return out


@kernel()
@no_type_check
def _answer(value, slope_of_value, slope, effect, control, weights, gain, offset):
    """Minimize one step's cost plus the following value over the inputs."""
    projected = _product(effect.T, value)  # (2, 5)
    square = _product(projected, effect)
    a, b, d = square[0, 0] + weights[5] + weights[12], square[0, 1], square[1, 1] + weights[6] + weights[13]
    determinant = a * d - b * b
    by_state = _product(projected, slope)
    for j in range(STATES):
        gain[0, j] = -(d * by_state[0, j] - b * by_state[1, j]) / determinant
        gain[1, j] = -(a * by_state[1, j] - b * by_state[0, j]) / determinant
    u, w = weights[5] * control[0], weights[6] * control[1]
    for i in range(STATES):
        u += effect[i, 0] * slope_of_value[i]
        w += effect[i, 1] * slope_of_value[i]
    offset[0] = -(d * u - b * w) / determinant
    offset[1] = -(a * w - b * u) / determinant


@kernel()
@no_type_check
def _before(value, slope_of_value, slope, effect, gain, offset, control, weights):
    """Return value and gradient one step earlier, without that step's tracking error."""
    closed = slope + _product(effect, gain)
    earlier = _product(closed.T, _product(value, closed))
    earlier_slope, reached = np.zeros(STATES), slope_of_value.copy()
    for i in range(STATES):
        for j in range(STATES):
            for u in range(INPUTS):
                reached[i] += value[i, j] * effect[j, u] * offset[u]
    for i in range(STATES):
        earlier[i, i] += weights[i] + weights[7 + i]
        for m in range(STATES):
            earlier_slope[i] += closed[m, i] * reached[m]
        for u in range(INPUTS):
            force = weights[5 + u] * (control[u] + offset[u]) + weights[12 + u] * offset[u]
            earlier_slope[i] += gain[u, i] * force
            for j in range(STATES):
                earlier[i, j] += (weights[5 + u] + weights[12 + u]) * gain[u, i] * gain[u, j]
    return earlier, earlier_slope


# Initial guess of the iLQR tracker

_JERK_PENALTY, _CURVATURE_RATE_PENALTY, _CURVATURE_PENALTY = 1e-4, 1e-2, 1e-10
_SPEED_GAIN, _STEER_GAIN = 0.5, 0.05


def first_inputs(
    states: Float64[np.ndarray, "points 5"], speed_m_s: float, steer_rad: float, wheelbase_m: float, dt_s: float
) -> Float64[np.ndarray, "n 2"]:
    """Return accelerations and steering rates that approximately follow given poses from a given speed and steering.

    Speeds and curvatures are fitted to the poses by least squares (nuPlan's tracker: penalties 1e-4 on the change of
    acceleration, 1e-2 on the change of curvature), and the first inputs are corrected by 0.5 and 0.05 times the errors
    of speed and steering. nuPlan's lateral error correction (gain 0.1, 15 m ahead) is not needed, because plans start
    at the vehicle.
    """
    speeds = _fitted_speeds(states, dt_s)
    steers = np.arctan(wheelbase_m * _fitted_curvatures(states, speeds, dt_s))
    inputs = np.zeros((len(states) - 1, 2))
    if len(inputs) > 1:
        inputs[:-1, 0], inputs[:-1, 1] = np.diff(speeds) / dt_s, np.diff(steers) / dt_s
        inputs[-1] = inputs[-2]
    inputs[0] += _SPEED_GAIN * (speeds[0] - speed_m_s), _STEER_GAIN * (steers[0] - steer_rad)
    return inputs


def _fitted_speeds(states: Float64[np.ndarray, "points 5"], dt_s: float) -> Float64[np.ndarray, " n"]:
    """Return the speeds whose Euler steps along the headings fit the poses best."""
    headings, count = states[:-1, 2], len(states) - 1
    steps = np.diff(states[:, :2], axis=0)
    # Unknowns are the first speed and the accelerations; each step's measurement is its length along its heading.
    forward = steps[:, 0] * np.cos(headings) + steps[:, 1] * np.sin(headings)
    matrix = np.tril(np.full((count, count), dt_s**2))
    matrix[:, 0] = dt_s
    changes = np.diff(np.eye(count)[1:], axis=0)
    fitted = _regularized_least_squares(matrix, forward, _JERK_PENALTY * changes.T @ changes)
    return fitted[0] + dt_s * np.concatenate([[0.0], np.cumsum(fitted[1:])])


def _fitted_curvatures(
    states: Float64[np.ndarray, "points 5"], speeds: Float64[np.ndarray, " n"], dt_s: float
) -> Float64[np.ndarray, " n"]:
    """Return the curvatures whose Euler steps at given speeds fit the turns between the poses best."""
    turns = wrap_angle(np.diff(states[:, 2]))
    count = len(turns)
    matrix = np.tril(np.full((count, count), dt_s**2)) * speeds[:, None]
    matrix[:, 0] = speeds * dt_s
    penalties = np.full(count, _CURVATURE_RATE_PENALTY)
    penalties[0] = _CURVATURE_PENALTY  # keeps the system solvable at standstill
    fitted = _regularized_least_squares(matrix, turns, np.diag(penalties))
    return fitted[0] + dt_s * np.concatenate([[0.0], np.cumsum(fitted[1:])])


def _regularized_least_squares(
    matrix: Float64[np.ndarray, "n n"], reference: Float64[np.ndarray, " n"], penalty: Float64[np.ndarray, "n n"]
) -> Float64[np.ndarray, " n"]:
    return np.linalg.pinv(matrix.T @ matrix + penalty) @ (matrix.T @ reference)
