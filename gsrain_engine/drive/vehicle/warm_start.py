"""Where the iLQR tracker's search begins: the inputs that a plan itself seems to have been driven with."""

import numpy as np
from jaxtyping import Float64

from ..angles import wrapped

_JERK_PENALTY, _CURVATURE_RATE_PENALTY, _CURVATURE_PENALTY = 1e-4, 1e-2, 1e-10
_SPEED_GAIN, _STEER_GAIN = 0.5, 0.05


def first_inputs(
    states: Float64[np.ndarray, "points 5"], speed_m_s: float, steer_rad: float, wheelbase_m: float, dt_s: float
) -> Float64[np.ndarray, "n 2"]:
    """Return accelerations and steering rates that lead about along given poses, from a given speed and steering.

    Speeds and curvatures are fitted to the poses by least squares (nuPlan's tracker: penalties 1e-4 on the change of
    acceleration, 1e-2 on the change of curvature), and the first inputs are corrected by 0.5 and 0.05 times what speed
    and steering are off. nuPlan's correction of a lateral error (gain 0.1, 15 m ahead) has nothing to correct here:
    plans begin at the vehicle.
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
    """Speeds whose Euler steps along the headings come nearest to the poses."""
    headings, count = states[:-1, 2], len(states) - 1
    steps = np.diff(states[:, :2], axis=0)
    # Of unknown first speed and accelerations; each step's measurement is its length along its heading.
    forward = steps[:, 0] * np.cos(headings) + steps[:, 1] * np.sin(headings)
    matrix = np.tril(np.full((count, count), dt_s**2))
    matrix[:, 0] = dt_s
    changes = np.diff(np.eye(count)[1:], axis=0)
    fitted = _least_squares(matrix, forward, _JERK_PENALTY * changes.T @ changes)
    return fitted[0] + dt_s * np.concatenate([[0.0], np.cumsum(fitted[1:])])


def _fitted_curvatures(
    states: Float64[np.ndarray, "points 5"], speeds: Float64[np.ndarray, " n"], dt_s: float
) -> Float64[np.ndarray, " n"]:
    """Curvatures whose Euler steps at given speeds come nearest to the turns between the poses."""
    turns = wrapped(np.diff(states[:, 2]))
    count = len(turns)
    matrix = np.tril(np.full((count, count), dt_s**2)) * speeds[:, None]
    matrix[:, 0] = speeds * dt_s
    penalties = np.full(count, _CURVATURE_RATE_PENALTY)
    penalties[0] = _CURVATURE_PENALTY  # so that a standstill has an answer too
    fitted = _least_squares(matrix, turns, np.diag(penalties))
    return fitted[0] + dt_s * np.concatenate([[0.0], np.cumsum(fitted[1:])])


def _least_squares(
    matrix: Float64[np.ndarray, "n n"], wanted: Float64[np.ndarray, " n"], penalty: Float64[np.ndarray, "n n"]
) -> Float64[np.ndarray, " n"]:
    return np.linalg.pinv(matrix.T @ matrix + penalty) @ (matrix.T @ wanted)
