import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.simulation.vehicle import Control, Vehicle, VehicleState, limit_control, step_bicycle

CAR = Vehicle()


def test_a_straight_line_under_acceleration_is_exact_in_steps_of_any_length():
    for dt in (0.05, 0.25, 1.0):
        state = VehicleState(1.0, 2.0, np.pi / 6, 4.0)
        for _ in range(round(2 / dt)):
            state = step_bicycle(CAR, state, Control(1.5, 0.0), dt)
        way = 4.0 * 2 + 0.5 * 1.5 * 2**2
        assert (state.x_m, state.y_m) == pytest.approx((1 + way * np.cos(np.pi / 6), 2 + way / 2), abs=1e-12)
        assert (state.speed_m_s, state.yaw_rad) == pytest.approx((7.0, np.pi / 6), abs=1e-12)


def test_a_circle_at_constant_speed_is_exact():
    radius, speed, dt = 20.0, 5.0, 0.25
    state = VehicleState(0.0, 0.0, 0.0, speed, float(np.arctan(CAR.wheelbase_m / radius)))
    for k in range(1, 60):
        state = step_bicycle(CAR, state, Control(0.0, 0.0), dt)
        turned = speed * k * dt / radius
        place = radius * np.sin(turned), radius * (1 - np.cos(turned))
        assert (state.x_m, state.y_m) == pytest.approx(place, abs=1e-9)
        assert state.yaw_rad == pytest.approx(turned)


def test_steps_converge_with_the_square_of_their_length():
    def end(dt: float) -> np.ndarray:
        state = VehicleState(0.0, 0.0, 0.0, 5.0)
        for _ in range(round(2 / dt)):
            state = step_bicycle(CAR, state, Control(0.8, 0.2), dt)
        return np.array([state.x_m, state.y_m, state.yaw_rad])

    fine = end(1 / 512)
    coarse, half = np.abs(end(0.25) - fine).max(), np.abs(end(0.125) - fine).max()
    assert coarse < 0.03
    assert 3 < coarse / half < 5


def test_braking_ends_at_standstill_and_does_not_go_back():
    state = VehicleState(0.0, 0.0, 0.0, 1.0)
    assert limit_control(CAR, state, Control(-8.0, 0.0), 0.25) == Control(-4.0, 0.0)
    stopped = step_bicycle(CAR, state, Control(-8.0, 0.0), 0.25)
    assert (stopped.x_m, stopped.speed_m_s) == (0.125, 0.0)
    assert step_bicycle(CAR, stopped, Control(-8.0, 0.0), 0.25) == stopped


def test_a_standing_vehicle_turns_its_wheels_and_nothing_else():
    state = step_bicycle(CAR, VehicleState(3.0, 4.0, 0.5), Control(0.0, 0.4), 0.5)
    assert state == VehicleState(3.0, 4.0, 0.5, 0.0, 0.2)


@pytest.mark.parametrize(
    ("state", "asked", "done"),
    [
        (VehicleState(0, 0, 0, 10.0), Control(-20.0, 3.0), Control(-8.0, 0.4)),
        (VehicleState(0, 0, 0, 10.0), Control(20.0, -3.0), Control(3.0, -0.4)),
        (VehicleState(0, 0, 0, 49.75), Control(3.0, 0.0), Control(1.0, 0.0)),
        (VehicleState(0, 0, 0, 60.0), Control(3.0, 0.0), Control(-8.0, 0.0)),
        (VehicleState(0, 0, 0, 5.0, CAR.most_steer_rad), Control(0.0, 0.4), Control(0.0, 0.0)),
        (VehicleState(0, 0, 0, 5.0, -CAR.most_steer_rad + 0.05), Control(0.0, -0.4), Control(0.0, -0.2)),
    ],
)
def test_controls_are_cut_to_what_the_vehicle_can_do(state, asked, done):
    assert limit_control(CAR, state, asked, 0.25) == pytest.approx(done)


reals = st.floats(-1e6, 1e6)


@given(st.floats(0, 50), st.floats(-1.04, 1.04), reals, reals, st.floats(0.01, 1.0))
def test_whatever_is_asked_the_limits_hold(speed, steer, acceleration, rate, dt):
    before = VehicleState(0.0, 0.0, 0.0, speed, steer)
    after = step_bicycle(CAR, before, Control(acceleration, rate), dt)
    assert 0 <= after.speed_m_s <= CAR.top_speed_m_s + 1e-9
    assert abs(after.steer_rad) <= CAR.most_steer_rad + 1e-12
    assert abs(after.steer_rad - steer) <= CAR.most_steer_rate_rad_s * dt + 1e-12
    assert np.hypot(after.x_m, after.y_m) <= max(speed, after.speed_m_s) * dt + 1e-9
