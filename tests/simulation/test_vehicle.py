"""Angles, routes, and the bicycle model: exact where it should be, and within the vehicle's limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.simulation.geometry import Route, wrap_angle, wrap_degrees
from gsrain_engine.simulation.vehicle import Control, Vehicle, VehicleState, limit_control, step_bicycle

CAR = Vehicle()
meters, angles = st.floats(-100, 100), st.floats(-3.1, 3.1)


@given(angles, st.integers(-3, 3))
def test_whole_turns_do_not_matter(angle, turns):
    assert wrap_angle(angle + turns * 2 * np.pi) == pytest.approx(angle, abs=1e-12)
    assert wrap_degrees(np.degrees(angle) + 360.0 * turns) == pytest.approx(np.degrees(angle), abs=1e-9)
    np.testing.assert_allclose(wrap_angle(np.array([angle]) + turns * 2 * np.pi), [angle], atol=1e-12)


@given(st.floats(-50, 150), st.floats(-4, 4))
def test_a_place_beside_a_bend_is_found_on_it(along, left):
    turn = np.linspace(0, np.pi / 2, 40)
    bend = Route(np.stack([60 * np.sin(turn), 60 * (1 - np.cos(turn))], axis=1))
    x, y, _ = bend.at(along, left)
    assert bend.nearest(x, y) == pytest.approx((along, left), abs=0.17)  # beside a corner two places are as near
    ahead = bend.ahead(along, 3.0, 1.5)
    np.testing.assert_allclose(ahead[0], bend.at(along)[:2])
    assert np.linalg.norm(ahead[2] - ahead[0]) == pytest.approx(3.0, abs=0.01)


@given(meters, meters, angles, meters, meters)
def test_the_vehicles_frame_and_back(x, y, yaw, ahead, left):
    state, place = VehicleState(x, y, yaw), np.array([[ahead, left]])
    np.testing.assert_allclose(state.from_world(state.to_world(place)), place, atol=1e-9)
    np.testing.assert_allclose(state.rig_to_world(2.0) @ (ahead, left, 0, 1), (*state.to_world(place)[0], 2, 1))


@pytest.mark.parametrize("dt", [0.05, 0.25, 1.0])
def test_a_straight_line_under_acceleration_is_exact_in_steps_of_any_length(dt):
    state = VehicleState(1.0, 2.0, np.pi / 6, 4.0)
    for _ in range(round(2 / dt)):
        state = step_bicycle(CAR, state, Control(1.5, 0.0), dt)
    distance = 4.0 * 2 + 0.5 * 1.5 * 2**2
    assert (state.x_m, state.y_m) == pytest.approx((1 + distance * np.cos(np.pi / 6), 2 + distance / 2), abs=1e-12)
    assert (state.speed_m_s, state.yaw_rad) == pytest.approx((7.0, np.pi / 6), abs=1e-12)


def test_a_circle_at_constant_speed_is_exact():
    radius, speed, dt = 20.0, 5.0, 0.25
    state = VehicleState(0.0, 0.0, 0.0, speed, float(np.arctan(CAR.wheelbase_m / radius)))
    for k in range(1, 60):
        state = step_bicycle(CAR, state, Control(0.0, 0.0), dt)
        turned = speed * k * dt / radius
        place = radius * np.sin(turned), radius * (1 - np.cos(turned))
        assert (state.x_m, state.y_m, state.yaw_rad) == pytest.approx((*place, turned), abs=1e-9)


@pytest.mark.parametrize(
    ("state", "asked", "done"),
    [
        (VehicleState(0, 0, 0, 10.0), Control(-20.0, 3.0), Control(-8.0, 0.4)),
        (VehicleState(0, 0, 0, 10.0), Control(20.0, -3.0), Control(3.0, -0.4)),
        (VehicleState(0, 0, 0, 1.0), Control(-8.0, 0.0), Control(-4.0, 0.0)),
        (VehicleState(0, 0, 0, 49.75), Control(3.0, 0.0), Control(1.0, 0.0)),
        (VehicleState(0, 0, 0, 60.0), Control(3.0, 0.0), Control(-8.0, 0.0)),
        (VehicleState(0, 0, 0, 5.0, CAR.most_steer_rad), Control(0.0, 0.4), Control(0.0, 0.0)),
        (VehicleState(0, 0, 0, 5.0, -CAR.most_steer_rad + 0.05), Control(0.0, -0.4), Control(0.0, -0.2)),
    ],
)
def test_controls_are_cut_to_what_the_vehicle_can_do(state, asked, done):
    assert limit_control(CAR, state, asked, 0.25) == pytest.approx(done)


@given(st.floats(0, 50), st.floats(-1.04, 1.04), st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(0.01, 1.0))
def test_whatever_is_asked_the_limits_hold(speed, steer, acceleration, rate, dt):
    after = step_bicycle(CAR, VehicleState(0.0, 0.0, 0.0, speed, steer), Control(acceleration, rate), dt)
    assert 0 <= after.speed_m_s <= CAR.top_speed_m_s + 1e-9
    assert abs(after.steer_rad) <= CAR.most_steer_rad + 1e-12
    assert abs(after.steer_rad - steer) <= CAR.most_steer_rate_rad_s * dt + 1e-12
    assert np.hypot(after.x_m, after.y_m) <= max(speed, after.speed_m_s) * dt + 1e-9
