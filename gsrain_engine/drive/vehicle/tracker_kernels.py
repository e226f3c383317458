"""The inner loops of the iLQR tracker: how the bicycle moves in its time grid, and the step back through the horizon.

States are x, y, heading, speed, steering angle of the front wheels; inputs are acceleration and steering rate. Small
matrices are multiplied by plain loops, so that results don't depend on which BLAS is installed. `at` is the part of a
step at which speed, steering and heading are taken: 0 is Euler's rule (nuPlan's), which cuts corners, 0.5 the midpoint.
"""

from typing import no_type_check

import numba
import numpy as np

STATES, INPUTS = 5, 2
_SLOWEST_M_S = 0.01
"""The slowest speed to linearize at: at a standstill steering would seem to be without any effect."""


@numba.njit(cache=True)
@no_type_check
def wrapped(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


@numba.njit(cache=True)
@no_type_check
def moved(state, control, dt, at, wheelbase, limits, after):
    """Write the state after a time; `control` is cut to what `limits` allow.

    `limits`: most braking, most acceleration, most steering rate, most steering angle.
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


@numba.njit(cache=True)
@no_type_check
def linearized(state, control, dt, at, wheelbase, slope, effect):
    """Write the derivatives of `moved` by the state, (5, 5), and by the control within its limits, (5, 2)."""
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


@numba.njit(cache=True)
@no_type_check
def rolled_out(start, controls, dt, at, wheelbase, limits, states):
    """Write the states that controls lead to, the start first; `controls` are cut to what is allowed."""
    states[0] = start
    for k in range(len(controls)):
        moved(states[k], controls[k], dt, at, wheelbase, limits, states[k + 1])


@numba.njit(cache=True)
@no_type_check
def policy(states, controls, wanted, dt, at, wheelbase, weights, gains, offsets):
    """Write the best linear answer to deviations, by dynamic programming from the horizon back.

    `weights`: of state errors (5), inputs (2), deviations of states (5) and of inputs (2) from the present iterate; the
    last two are the trust region. The answer is `gains[k] @ deviation + offsets[k]`.
    """
    count = len(controls)
    value, slope_of_value = np.zeros((STATES, STATES)), np.zeros(STATES)
    for i in range(STATES):
        value[i, i] = weights[i] + weights[7 + i]
    _add_error(states[count], wanted[count], weights, slope_of_value)
    slope, effect = np.empty((STATES, STATES)), np.empty((STATES, INPUTS))
    for k in range(count - 1, -1, -1):
        linearized(states[k], controls[k], dt, at, wheelbase, slope, effect)
        _answer(value, slope_of_value, slope, effect, controls[k], weights, gains[k], offsets[k])
        value, slope_of_value = _before(
            value, slope_of_value, slope, effect, gains[k], offsets[k], controls[k], weights
        )
        _add_error(states[k], wanted[k], weights, slope_of_value)


@numba.njit(cache=True)
@no_type_check
def improved(states, controls, dt, at, wheelbase, limits, gains, offsets, better):
    """Write the controls that an answer to deviations leads to, from the same start."""
    now, deviation, after = states[0].copy(), np.zeros(STATES), np.empty(STATES)
    for k in range(len(controls)):
        for i in range(INPUTS):
            better[k, i] = controls[k, i] + offsets[k, i]
            for j in range(STATES):
                better[k, i] += gains[k, i, j] * deviation[j]
        moved(now, better[k], dt, at, wheelbase, limits, after)
        now[:] = after
        deviation[:] = after - states[k + 1]


@numba.njit(cache=True)
@no_type_check
def _add_error(state, wanted, weights, slope_of_value):
    """Add the slope of a moment's tracking cost."""
    for i in range(STATES):
        error = state[i] - wanted[i]
        slope_of_value[i] += weights[i] * (wrapped(error) if i == 2 else error)


@numba.njit(cache=True)
@no_type_check
def _product(left, right):
    """Multiply two small matrices."""
    out = np.zeros((left.shape[0], right.shape[1]))
    for i in range(left.shape[0]):
        for m in range(left.shape[1]):
            for j in range(right.shape[1]):
                out[i, j] += left[i, m] * right[m, j]
    return out


@numba.njit(cache=True)
@no_type_check
def _answer(value, slope_of_value, slope, effect, control, weights, gain, offset):
    """Minimize a step's cost and the value after it over the inputs."""
    pulled = _product(effect.T, value)  # (2, 5)
    square = _product(pulled, effect)
    a, b, d = square[0, 0] + weights[5] + weights[12], square[0, 1], square[1, 1] + weights[6] + weights[13]
    determinant = a * d - b * b
    pulls = _product(pulled, slope)
    for j in range(STATES):
        gain[0, j] = -(d * pulls[0, j] - b * pulls[1, j]) / determinant
        gain[1, j] = -(a * pulls[1, j] - b * pulls[0, j]) / determinant
    u, w = weights[5] * control[0], weights[6] * control[1]
    for i in range(STATES):
        u += effect[i, 0] * slope_of_value[i]
        w += effect[i, 1] * slope_of_value[i]
    offset[0] = -(d * u - b * w) / determinant
    offset[1] = -(a * w - b * u) / determinant


@numba.njit(cache=True)
@no_type_check
def _before(value, slope_of_value, slope, effect, gain, offset, control, weights):
    """Return value and slope one step earlier, the tracking error of that moment aside."""
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
            pull = weights[5 + u] * (control[u] + offset[u]) + weights[12 + u] * offset[u]
            earlier_slope[i] += gain[u, i] * pull
            for j in range(STATES):
                earlier[i, j] += (weights[5 + u] + weights[12 + u]) * gain[u, i] * gain[u, j]
    return earlier, earlier_slope
