import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller_loop import CAR, STRAIGHT, circle, driven, lane_change
from gsrain_engine.simulation.controller_base import Controller, ControllerSettings, PurePursuit
from gsrain_engine.simulation.controllers import ILQRTracker, open_controller
from gsrain_engine.simulation.vehicle import Control, VehicleState, step_bicycle

AHEAD = np.stack([2.5 * np.arange(1, 7), np.zeros(6)], axis=1)
STAND = np.zeros((6, 2))
AT_5 = VehicleState(0.0, 0.0, 0.0, 5.0)


def tracker(**settings) -> ILQRTracker:
    return ILQRTracker(ControllerSettings(**settings))


def standing(controller, state, steps=40, noise=0.0):
    """Ask for a full stop, again and again; returns all states."""
    random, states = np.random.default_rng(0), [state]
    for _ in range(steps):
        plan = noise * random.normal(size=(6, 2))
        states.append(step_bicycle(CAR, states[-1], controller.control(CAR, states[-1], plan, 0.5), 0.25))
    return states


def test_the_published_heading_gives_the_published_controls():
    # Measured with HUGSIM's own code on a straight plan at 5 m/s: +0.298 m/s2 and +0.117 rad/s to its right.
    control = tracker(heading_reference="hugsim").control(CAR, AT_5, AHEAD, 0.5)
    assert control.acceleration_m_s2 == pytest.approx(0.298, abs=5e-4)
    assert control.steer_rate_rad_s == pytest.approx(-0.117, abs=5e-4)


def test_the_published_heading_turns_with_a_hair_to_the_side():
    hair = 0.01 * np.arange(1, 7)[:, None] * (0, 1)
    rates = [tracker(heading_reference="hugsim").control(CAR, AT_5, AHEAD + side * hair, 0.5)[1] for side in (-1, 1)]
    assert rates[0] < -0.1 < 0.1 < rates[1]
    assert rates[0] == pytest.approx(-rates[1], abs=1e-4)


def test_the_plans_own_heading_leaves_a_straight_drive_alone():
    assert tracker().control(CAR, AT_5, AHEAD, 0.5) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_left_and_right_are_mirrored():
    plan = np.cumsum([[2.5, 0.1], [2.6, 0.4], [2.4, 0.3], [2.5, 0.0], [2.4, -0.1]], axis=0)
    left = tracker().control(CAR, VehicleState(0, 0, 0, 5.0, 0.1), plan, 0.5)
    right = tracker().control(CAR, VehicleState(0, 0, 0, 5.0, -0.1), plan * (1, -1), 0.5)
    assert right == pytest.approx((left[0], -left[1]), abs=1e-6)


def test_inputs_are_a_minimum_of_what_is_minimized():
    # Against plain numbers: any small change of the inputs found makes the cost larger.
    plan = np.cumsum([[2.5, 0.1], [2.6, 0.3], [2.7, 0.4], [2.7, 0.5]], axis=0)
    found = tracker().inputs(CAR, AT_5, plan, 0.5)
    least = _cost(found, plan)
    for k in range(4):
        for axis in range(2):
            for change in (-1e-3, 1e-3):
                other = found.copy()
                other[k, axis] += change
                assert _cost(other, plan) > least


def _cost(inputs, plan):
    x = y = heading = steer = 0.0
    speed, cost, dt = 5.0, 0.0, 0.5
    steps = np.diff(np.concatenate([[(0.0, 0.0)], plan]), axis=0)
    ways = np.arctan2(steps[:, 1], steps[:, 0])
    wanted = np.concatenate([(ways[1:] + ways[:-1]) / 2, [ways[-1] + (ways[-1] - ways[-2]) / 2]])
    for (acceleration, rate), point, want in zip(inputs, plan, wanted, strict=True):
        mean_speed, mean_steer = speed + acceleration * dt / 2, steer + rate * dt / 2
        turn = mean_speed * np.tan(mean_steer) / CAR.wheelbase_m * dt
        x += mean_speed * np.cos(heading + turn / 2) * dt
        y += mean_speed * np.sin(heading + turn / 2) * dt
        heading, speed, steer = heading + turn, speed + acceleration * dt, steer + rate * dt
        cost += (x - point[0]) ** 2 + (y - point[1]) ** 2 + 10 * (heading - want) ** 2
        cost += acceleration**2 + 10 * rate**2
    return cost


def test_a_straight_line_is_kept_at_any_speed():
    for speed in (1.0, 5.0, 15.0):
        states, left, _ = driven(tracker(), STRAIGHT, speed, steps=30)
        assert np.abs(left).max() < 1e-9
        assert states[-1].speed_m_s == pytest.approx(speed, abs=1e-6)


def test_it_comes_back_to_a_straight_line():
    _, left, _ = driven(tracker(), STRAIGHT, 8.0, VehicleState(0.0, 0.5, 0.05, 8.0), steps=60)
    assert np.abs(left[:20]).max() < 0.8
    assert np.abs(left[40:]).max() < 0.02


def test_it_speeds_up_from_a_standstill():
    states, _, controls = driven(tracker(), STRAIGHT, 5.0, VehicleState(0.0, 0.0, 0.0))
    assert states[-1].speed_m_s == pytest.approx(5.0, abs=1e-3)
    assert controls[:, 0].max() <= 3.0
    assert np.abs(controls[:, 1]).max() < 1e-9


def test_a_circle_of_20_m_is_kept():
    states, left, _ = driven(tracker(), circle(20.0), 5.0)
    assert np.abs(left).max() < 0.35  # the wheels have to be turned first
    assert np.abs(left[30:]).max() < 0.02
    assert states[-1].steer_rad == pytest.approx(np.arctan(CAR.wheelbase_m / 20), abs=0.005)


def test_a_lane_change_is_driven():
    states, left, controls = driven(tracker(), lane_change(), 8.0)
    assert np.abs(left).max() < 0.06
    assert states[-1].y_m == pytest.approx(3.5, abs=0.01)
    assert np.abs(np.diff(controls[:, 1])).max() < 0.05  # it does not hunt


@pytest.mark.parametrize("steer", [0.0, 0.2])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_full_stop_is_braked_straight(steer, noise):
    states = standing(tracker(), VehicleState(0.0, 0.0, 0.0, 8.0, steer), noise=noise)
    end = states[-1]
    assert end.speed_m_s == 0.0
    assert states[10].x_m == pytest.approx(8.0**2 / (2 * 3), abs=0.2)
    assert all(abs(state.steer_rad) <= steer + 0.01 for state in states)
    assert abs(end.steer_rad) < 0.01
    assert abs(end.yaw_rad) < (0.2 if steer else 0.01)


def test_what_stands_stays():
    held = standing(tracker(), VehicleState(3.0, 4.0, 0.5, 0.0, 0.1), steps=10)
    for state in held:
        assert (state.x_m, state.y_m, state.speed_m_s) == pytest.approx((3.0, 4.0, 0.0), abs=1e-9)


def test_the_published_tracker_swerves_where_it_should_stop():
    # What one of the departures from it is for; the other is in test_tracker_kernels.py.
    stop = standing(tracker(heading_reference="hugsim"), VehicleState(0.0, 0.0, 0.0, 8.0, 0.2))
    assert abs(stop[-1].yaw_rad) > 0.8


def test_braking_harder_is_a_setting_and_the_vehicles_matter():
    hard = tracker(most_braking_m_s2=8.0)
    assert tracker().control(CAR, VehicleState(0, 0, 0, 10.0), STAND, 0.5).acceleration_m_s2 == -3.0
    assert hard.control(CAR, VehicleState(0, 0, 0, 10.0), STAND, 0.5).acceleration_m_s2 == -8.0
    states = standing(hard, VehicleState(0.0, 0.0, 0.0, 10.0))
    assert states[-1].x_m == pytest.approx(10.0**2 / (2 * 8), abs=0.1)


def test_iterations_end_it():
    plan = np.cumsum([[2.5, 0.1], [2.6, 0.4], [2.4, 0.3], [2.5, 0.0], [2.4, -0.1]], axis=0)
    one, ten, many, more = (tracker(iterations=n).control(CAR, AT_5, plan, 0.5) for n in (1, 10, 100, 1000))
    assert one != ten
    assert many == more  # it has converged before


def test_a_plan_of_one_point_is_enough():
    control = tracker().control(CAR, AT_5, np.array([[3.0, 0.0]]), 0.5)
    assert np.isfinite(control).all()


coordinates = st.tuples(st.floats(-60, 60), st.floats(-60, 60))


@settings(max_examples=60)
@given(
    st.lists(coordinates, min_size=1, max_size=8),
    st.floats(0, 50),
    st.floats(-1.047, 1.047),
    st.sampled_from(["tangent", "hugsim"]),
)
def test_whatever_is_planned_controls_are_finite_and_within_limits(plan, speed, steer, reference):
    control = tracker(heading_reference=reference).control(
        CAR, VehicleState(0.0, 0.0, 0.0, speed, steer), np.array(plan, np.float64), 0.5
    )
    assert abs(control.acceleration_m_s2) <= 3.0
    assert abs(control.steer_rate_rad_s) <= 0.4 + 1e-12


def test_settings_choose_the_controller():
    assert isinstance(open_controller(ControllerSettings()), ILQRTracker)
    assert isinstance(open_controller(ControllerSettings(kind="pure-pursuit")), PurePursuit)
    assert isinstance(tracker(), Controller)
    assert isinstance(tracker().control(CAR, AT_5, AHEAD, 0.5), Control)
