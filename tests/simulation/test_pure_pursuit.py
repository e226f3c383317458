import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller_loop import CAR, STRAIGHT, circle, driven, lane_change
from gsrain_engine.simulation.controller_base import Controller, PurePursuit
from gsrain_engine.simulation.vehicle import VehicleState, step_bicycle


def test_it_is_a_controller_and_leaves_a_straight_drive_alone():
    states, left, controls = driven(PurePursuit(), STRAIGHT, 6.0, steps=20)
    assert isinstance(PurePursuit(), Controller)
    assert np.abs(controls).max() < 1e-9
    assert np.abs(left).max() < 1e-9
    assert states[-1].speed_m_s == pytest.approx(6.0)


def test_a_circle_and_a_lane_change_are_kept():
    states, left, _ = driven(PurePursuit(), circle(20.0), 5.0)
    assert np.abs(left).max() < 0.3
    assert np.abs(left[30:]).max() < 0.05
    assert states[-1].steer_rad == pytest.approx(np.arctan(CAR.wheelbase_m / 20), abs=0.01)
    _, left, _ = driven(PurePursuit(), lane_change(), 8.0)
    assert np.abs(left).max() < 0.2


def test_it_takes_the_acceleration_of_the_plan():
    times = 0.5 * np.arange(1, 7)
    for wanted in (-4.0, 0.0, 1.5):
        way = 8.0 * times + 0.5 * wanted * times**2
        plan = np.stack([way, np.zeros(6)], axis=1)[: 3 if wanted < 0 else 6]
        control = PurePursuit().control(CAR, VehicleState(0, 0, 0, 8.0), plan, 0.5)
        assert control == pytest.approx((wanted, 0.0))


def test_a_full_stop_is_braked_straight_and_held():
    state = VehicleState(0.0, 0.0, 0.0, 8.0, 0.2)
    for _ in range(60):
        state = step_bicycle(CAR, state, PurePursuit().control(CAR, state, np.zeros((6, 2)), 0.5), 0.25)
    assert state.speed_m_s < 1e-4
    assert state.x_m < 5.0
    assert state.steer_rad == pytest.approx(0.0, abs=1e-6)


@given(st.lists(st.tuples(st.floats(-60, 60), st.floats(-60, 60)), min_size=1, max_size=8), st.floats(0, 50))
def test_whatever_is_planned_controls_are_finite(plan, speed):
    state = VehicleState(0.0, 0.0, 0.0, speed)
    assert np.isfinite(PurePursuit().control(CAR, state, np.array(plan, np.float64), 0.5)).all()
