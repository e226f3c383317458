"""HUGSIM's plans as ours."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.simulation.interop.hugsim_agent import to_vehicle_frame


def test_axes_above_the_axle():
    plan = np.array([[1.0, 5.0], [-2.0, 9.0]])  # right, forward
    np.testing.assert_array_equal(to_vehicle_frame(plan, (0.0, 0.0)), [[5.0, -1.0], [9.0, 2.0]])


def test_straight_on_is_the_same_for_every_point_of_the_vehicle():
    plan = np.stack([np.zeros(6), 4.0 * np.arange(1, 7)], axis=1)
    np.testing.assert_allclose(to_vehicle_frame(plan, (1.7, 0.02)), plan[:, ::-1], atol=1e-12)


def test_standing_still_stays():
    np.testing.assert_array_equal(to_vehicle_frame(np.zeros((6, 2)), (1.7, 0.02)), np.zeros((6, 2)))


@given(radius=st.floats(8, 80), side=st.sampled_from([-1, 1]), step=st.floats(0.5, 6))
def test_on_a_circle_the_axle_runs_on_the_smaller_one(radius, side, step):
    """The front of a car whose axle turns about (0, side * radius) runs on a larger circle; the axle comes back."""
    ahead = 1.7
    angles = step / radius * np.arange(1, 121) / 20
    axle = np.stack([radius * np.sin(angles), side * radius * (1 - np.cos(angles))], axis=1)
    headings = side * angles
    front = axle + ahead * np.stack([np.cos(headings), np.sin(headings)], axis=1) - (ahead, 0)
    back = to_vehicle_frame(np.stack([-front[:, 1], front[:, 0]], axis=1), (ahead, 0.0))
    np.testing.assert_allclose(back, axle, atol=2e-3 * step)


def test_behind_a_corner_the_axle_draws_a_tractrix():
    """The front leaves at a right angle: its trailer's heading follows tan(d / 2) = exp(-length / arm)."""
    length, arm = 3.0, 1.7
    back = to_vehicle_frame(np.array([[-length, 0.0]]), (arm, 0.0))  # to the left, x right
    apart = 2 * np.arctan(np.exp(-length / arm))
    heading = np.pi / 2 - apart
    front = np.array([arm, length])
    np.testing.assert_allclose(back[0], front - arm * np.array([np.cos(heading), np.sin(heading)]))


@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-1, 8)), min_size=1, max_size=8))
def test_the_front_always_stays_as_far_ahead(moves):
    front = np.cumsum(np.array(moves), axis=0)
    back = to_vehicle_frame(front, (1.7, 0.3))
    arms = np.array([1.7, 0.3]) + front[:, ::-1] * (1, -1) - back
    np.testing.assert_allclose(np.linalg.norm(arms, axis=1), np.hypot(1.7, 0.3), rtol=1e-9)


def test_a_plan_that_backs_by_a_hair_does_not_turn_the_car():
    back = to_vehicle_frame(np.array([[0.0, -0.01], [0.0, 0.0]]), (1.7, 0.0))
    assert np.abs(back[:, 1]).max() == pytest.approx(0, abs=1e-9)
