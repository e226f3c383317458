"""Angles, routes, and the bicycle model: exact where it should be, and within the vehicle's limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.simulation.geometry import Route, wrap_angle, wrap_degrees
from gsrain_engine.simulation.vehicle import Control, Vehicle, VehicleState, limit_control, step_bicycle

CAR = Vehicle()
meters, angles = st.floats(-100, 100), st.floats(-3.1, 3.1)


@given(meters, meters, angles, meters, meters, st.integers(-3, 3))
def test_the_vehicles_frame_and_back_and_whole_turns_do_not_matter(x, y, yaw, ahead, left, turns):
    state, place = VehicleState(x, y, yaw), np.array([[ahead, left]])
    np.testing.assert_allclose(state.from_world(state.to_world(place)), place, atol=1e-9)
    np.testing.assert_allclose(state.rig_to_world(2.0) @ (ahead, left, 0, 1), (*state.to_world(place)[0], 2, 1))
    assert wrap_angle(yaw + turns * 2 * np.pi) == pytest.approx(yaw, abs=1e-12)
    assert wrap_degrees(np.degrees(yaw) + 360.0 * turns) == pytest.approx(np.degrees(yaw), abs=1e-9)


@given(st.floats(-50, 150), st.floats(-4, 4))
def test_a_place_next_to_a_bend_is_found_on_it(along, left):
    turn = np.linspace(0, np.pi / 2, 40)
    bend = Route(np.stack([60 * np.sin(turn), 60 * (1 - np.cos(turn))], axis=1))
    x, y, _ = bend.at(along, left)
    assert bend.nearest(x, y) == pytest.approx((along, left), abs=0.17)  # two places are as near next to a corner
    ahead = bend.ahead(along, 3.0, 1.5)
    np.testing.assert_allclose(ahead, [bend.at(along + each)[:2] for each in (0.0, 1.5, 3.0)])


@pytest.mark.parametrize("dt", [0.05, 0.25, 1.0])
def test_lines_under_acceleration_and_circles_at_constant_speed_are_exact(dt):
    line = VehicleState(1.0, 2.0, np.pi / 6, 4.0)
    circle = VehicleState(0.0, 0.0, 0.0, 5.0, float(np.arctan(CAR.wheelbase_m / 20)))
    for k in range(1, round(2 / dt) + 1):
        line, circle = (step_bicycle(CAR, *each, dt) for each in ((line, Control(1.5, 0.0)), (circle, Control(0, 0))))
        time_s = k * dt
        gone, turned = 4.0 * time_s + 0.5 * 1.5 * time_s**2, 5.0 * time_s / 20
        expected = 1 + gone * np.cos(np.pi / 6), 2 + gone / 2, np.pi / 6, 4 + 1.5 * time_s
        assert (line.x_m, line.y_m, line.yaw_rad, line.speed_m_s) == pytest.approx(expected, abs=1e-12)
        expected = 20 * np.sin(turned), 20 * (1 - np.cos(turned)), turned
        assert (circle.x_m, circle.y_m, circle.yaw_rad) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("state", "asked", "done"),
    [
        (VehicleState(0, 0, 0, 10.0), Control(-20.0, 3.0), Control(-8.0, 0.4)),
        (VehicleState(0, 0, 0, 1.0), Control(-8.0, 0.0), Control(-4.0, 0.0)),
        (VehicleState(0, 0, 0, 49.75), Control(3.0, 0.0), Control(1.0, 0.0)),
        (VehicleState(0, 0, 0, 60.0), Control(3.0, 0.0), Control(-8.0, 0.0)),
        (VehicleState(0, 0, 0, 5.0, CAR.most_steer_rad), Control(20.0, 0.4), Control(3.0, 0.0)),
        (VehicleState(0, 0, 0, 5.0, -CAR.most_steer_rad + 0.05), Control(0.0, -0.4), Control(0.0, -0.2)),
    ],
)
def test_controls_are_cut_to_the_limits_of_the_vehicle(state, asked, done):
    assert limit_control(CAR, state, asked, 0.25) == pytest.approx(done)
