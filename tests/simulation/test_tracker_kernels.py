import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.simulation.controllers import (
    forward_pass,
    linearize_dynamics,
    roll_out,
    solve_lqr_policy,
    step_state,
)

DT, WHEELBASE = 0.5, 2.7
LIMITS = np.array([3.0, 3.0, 0.4, np.pi / 3])
WEIGHTS = np.array([1, 1, 10, 0, 0, 1, 10, *[1] * 7], np.float64)


EULER, MIDPOINT = 0.0, 0.5


def after(state, control, at):
    reached = np.empty(5)
    step_state(state, np.array(control, np.float64), DT, at, WHEELBASE, LIMITS, reached)
    return reached


def derivatives(state, control, at):
    slope, effect = np.empty((5, 5)), np.empty((5, 2))
    linearize_dynamics(state, np.array(control, np.float64), DT, at, WHEELBASE, slope, effect)
    return slope, effect


@pytest.mark.parametrize("at", [EULER, MIDPOINT])
@given(st.floats(-3, 3), st.floats(2, 20), st.floats(-0.8, 0.8), st.floats(-2, 2), st.floats(-0.3, 0.3))
def test_derivatives_are_those_of_finite_differences(at, heading, speed, steer, acceleration, rate):
    state, control, h = np.array([3.0, -2.0, heading, speed, steer]), np.array([acceleration, rate]), 1e-6
    slope, effect = derivatives(state, control, at)
    for j, step in enumerate(h * np.eye(5)):
        numeric = (after(state + step, control, at) - after(state - step, control, at)) / (2 * h)
        np.testing.assert_allclose(slope[:, j], numeric, rtol=1e-6, atol=1e-6)
    for j, step in enumerate(h * np.eye(2)):
        numeric = (after(state, control + step, at) - after(state, control - step, at)) / (2 * h)
        np.testing.assert_allclose(effect[:, j], numeric, rtol=1e-6, atol=1e-6)


def test_a_standstill_is_linearized_as_if_it_crept():
    for speed, sign in ((0.0, 1), (-0.001, -1)):
        slope, _ = derivatives(np.array([0.0, 0, 0, speed, 0]), (0.0, 0.0), EULER)
        assert slope[2, 4] == pytest.approx(sign * 0.01 * DT / WHEELBASE)


def test_the_midpoint_is_exact_where_euler_cuts_the_corner():
    radius, speed = 20.0, 5.0
    state = np.array([0.0, 0, 0, speed, np.arctan(WHEELBASE / radius)])
    turn, chord = speed * DT / radius, 2 * radius * np.sin(speed * DT / radius / 2)
    found = after(state, (0.0, 0.0), MIDPOINT)
    assert np.arctan2(found[1], found[0]) == pytest.approx(turn / 2)
    assert found[:2] == pytest.approx([chord * np.cos(turn / 2), chord * np.sin(turn / 2)], abs=0.002)
    assert after(state, (0.0, 0.0), EULER)[1] == 0


def test_controls_are_cut_to_the_limits_and_written_back():
    control = np.array([-9.0, 2.0])
    reached = np.empty(5)
    step_state(np.array([0.0, 0, 0, 5, np.pi / 3 - 0.05]), control, DT, EULER, WHEELBASE, LIMITS, reached)
    assert control == pytest.approx([-3.0, 0.1])
    assert reached[3:] == pytest.approx([3.5, np.pi / 3])


@pytest.mark.parametrize("at", [EULER, MIDPOINT])
def test_the_step_back_agrees_with_one_linear_system(at):
    random = np.random.default_rng(3)
    start, controls = np.array([0.0, 0, 0.1, 6, 0.05]), random.normal(0, (0.5, 0.05), (5, 2))
    wanted = np.concatenate([start[None], np.cumsum(random.normal((3, 0.2, 0.1, 0, 0), 0.2, (5, 5)), axis=0)])
    states = np.empty((6, 5))
    roll_out(start, controls, DT, at, WHEELBASE, LIMITS, states)
    gains, offsets = np.empty((5, 2, 5)), np.empty((5, 2))
    solve_lqr_policy(states, controls, wanted, DT, at, WHEELBASE, WEIGHTS, gains, offsets)
    np.testing.assert_allclose(offsets, _by_one_system(states, controls, wanted, at), atol=1e-8)


def _by_one_system(states, controls, wanted, at):
    """The changes of all inputs that minimize the linearized cost, as one linear system, and what stays of them.

    Offsets answer to no deviation before: each is the first of the inputs from its own moment on.
    """
    offsets = np.empty_like(controls)
    for first in range(len(controls)):
        count = len(controls) - first
        effect = np.zeros((count + 1, 5, 2 * count))
        for k in range(count):
            slope, by_input = derivatives(states[first + k], controls[first + k], at)
            effect[k + 1] = slope @ effect[k]
            effect[k + 1][:, 2 * k : 2 * k + 2] += by_input
        error = states[first + 1 :] - wanted[first + 1 :]
        errors, trusted = np.diag(WEIGHTS[:5]), np.diag(WEIGHTS[7:12])
        matrix = sum(each.T @ (errors + trusted) @ each for each in effect[1:])
        matrix = matrix + np.kron(np.eye(count), np.diag(WEIGHTS[5:7] + WEIGHTS[12:14]))
        pull = sum(each.T @ errors @ e for each, e in zip(effect[1:], error, strict=True))
        pull = pull + (controls[first:] * WEIGHTS[5:7]).ravel()
        offsets[first] = -np.linalg.solve(matrix, pull)[:2]
    return offsets


def test_no_answer_leaves_controls_alone():
    start, controls = np.array([0.0, 0, 0, 6, 0.05]), np.full((4, 2), 0.1)
    states, better = np.empty((5, 5)), np.empty((4, 2))
    roll_out(start, controls, DT, MIDPOINT, WHEELBASE, LIMITS, states)
    forward_pass(states, controls, DT, MIDPOINT, WHEELBASE, LIMITS, np.ones((4, 2, 5)), np.zeros((4, 2)), better)
    np.testing.assert_allclose(better, controls, atol=1e-15)
