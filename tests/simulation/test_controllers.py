"""Controllers: reference states, the iLQR kernels against plain algebra, and drives along lines without a scene."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.simulation import controller_base, controllers
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.vehicle import Vehicle, VehicleState, step_bicycle
from gsrain_engine.simulation.vehicle_settings import ControllerSettings

CAR = Vehicle()
AHEAD = np.stack([2.5 * np.arange(1, 7), np.zeros(6)], axis=1)
AT_5 = VehicleState(0.0, 0.0, 0.0, 5.0)
WIGGLE = np.cumsum([[2.5, 0.1], [2.6, 0.4], [2.4, 0.3], [2.5, 0.0], [2.4, -0.1]], axis=0)


DT, WHEELBASE = 0.5, 2.7


def tracker(**fields) -> controller_base.Controller:
    return controllers.open_controller(ControllerSettings(**fields))


def test_the_published_heading_gives_the_published_controls():
    # Measured with HUGSIM's own code on a straight plan at 5 m/s: +0.298 m/s2 and +0.117 rad/s to its right.
    published = tracker(heading_reference="hugsim")
    assert published.control(CAR, AT_5, AHEAD, 0.5) == pytest.approx((0.298, -0.117), abs=5e-4)
    hair = 0.01 * np.arange(1, 7)[:, None] * (0, 1)  # a hair to a side turns it
    rates = [published.control(CAR, AT_5, AHEAD + side * hair, 0.5)[1] for side in (-1, 1)]
    assert rates[0] < -0.1 and rates[0] == pytest.approx(-rates[1], abs=1e-4)


@pytest.mark.parametrize(("acceleration", "steer_rate"), [(0.0, 0.0), (0.8, 0.0), (0.0, 0.01), (-1.2, -0.02)])
def test_first_inputs_are_those_that_drove_the_poses(acceleration, steer_rate):
    """Poses of Euler steps at constant acceleration and growing curvature; both are fitted again."""
    speeds = 20.0 + acceleration * DT * np.arange(12)
    curvatures = 0.01 + steer_rate / WHEELBASE * DT * np.arange(12)
    states = np.zeros((13, 5))
    for k in range(12):
        yaw = states[k, 2]
        states[k + 1, :2] = states[k, :2] + DT * speeds[k] * np.array([np.cos(yaw), np.sin(yaw)])
        states[k + 1, 2] = yaw + DT * speeds[k] * curvatures[k]
    inputs = controllers.first_inputs(states, 20.0, np.arctan(WHEELBASE * 0.01), WHEELBASE, DT)
    np.testing.assert_allclose(inputs[:, 0], acceleration, atol=0.01)
    np.testing.assert_allclose(inputs[:, 1], steer_rate, atol=0.02 * abs(steer_rate) + 1e-4)
    slower = controllers.first_inputs(states, 18.0, np.arctan(WHEELBASE * 0.01) - 0.1, WHEELBASE, DT)
    np.testing.assert_allclose(slower[0] - inputs[0], (0.5 * 2.0, 0.05 * 0.1), rtol=1e-6)


def test_left_and_right_are_mirrored_and_a_straight_drive_is_left_alone():
    left, right = (
        tracker().control(CAR, VehicleState(0, 0, 0, 5.0, 0.1 * side), WIGGLE * (1, side), 0.5) for side in (1, -1)
    )
    assert right == pytest.approx((left[0], -left[1]), abs=1e-6)
    assert tracker().control(CAR, AT_5, AHEAD, 0.5) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_inputs_are_a_minimum_of_the_cost():
    """Any small change of the inputs makes the cost, in plain numbers, larger."""
    plan = np.cumsum([[2.5, 0.1], [2.6, 0.3], [2.7, 0.4], [2.7, 0.5]], axis=0)
    found = tracker().inputs(CAR, AT_5, plan, 0.5)
    for change in np.eye(8).reshape(8, 4, 2) * 1e-3:
        assert min(_cost(found + change, plan), _cost(found - change, plan)) > _cost(found, plan)


def _cost(inputs, plan):
    x = y = heading = steer = 0.0
    speed, cost, dt = 5.0, 0.0, 0.5
    steps = np.diff(np.concatenate([[(0.0, 0.0)], plan]), axis=0)
    along = np.arctan2(steps[:, 1], steps[:, 0])
    references = np.concatenate([(along[1:] + along[:-1]) / 2, [along[-1] + (along[-1] - along[-2]) / 2]])
    for (acceleration, rate), point, reference in zip(inputs, plan, references, strict=True):
        mean_speed, mean_steer = speed + acceleration * dt / 2, steer + rate * dt / 2
        turn = mean_speed * np.tan(mean_steer) / CAR.wheelbase_m * dt
        x += mean_speed * np.cos(heading + turn / 2) * dt
        y += mean_speed * np.sin(heading + turn / 2) * dt
        heading, speed, steer = heading + turn, speed + acceleration * dt, steer + rate * dt
        cost += (x - point[0]) ** 2 + (y - point[1]) ** 2 + 10 * (heading - reference) ** 2
        cost += acceleration**2 + 10 * rate**2
    return cost


# Drives of both controllers


def circle(radius_m):
    """Three quarters of a circle to the left that begins at the origin, along x."""
    turn = np.linspace(0, 1.5 * np.pi, 500)
    return Route(radius_m * np.stack([np.sin(turn), 1 - np.cos(turn)], axis=1))


def lane_change():
    """Straight, over to the left by a quintic, straight."""
    x = np.arange(0, 300, 0.5)
    s = np.clip((x - 20) / 40, 0, 1)
    return Route(np.stack([x, 3.5 * (10 * s**3 - 15 * s**4 + 6 * s**5)], axis=1))


STRAIGHT = Route(np.array([[0.0, 0], [500, 0]]))


@pytest.mark.parametrize(
    ("route", "speed", "ilqr_m", "pursuit_m"),
    [
        *((STRAIGHT, speed, 1e-9, 1e-9) for speed in (1.0, 5.0, 15.0)),
        (circle(20.0), 5.0, 0.35, 0.35),  # the wheels have to be turned first
        (lane_change(), 8.0, 0.06, 0.2),
    ],
    ids=["1 m/s", "5 m/s", "15 m/s", "circle", "lane change"],
)
def test_lines_are_followed(route, speed, ilqr_m, pursuit_m):
    for kind, error_m, settled_m in (("ilqr", ilqr_m, 0.02), ("pure-pursuit", pursuit_m, 0.2)):
        controller, state, left = tracker(kind=kind), VehicleState(0.0, 0.0, 0.0, speed), []
        for _ in range(60):
            along = route.nearest(state.x_m, state.y_m).along_m
            plan = state.from_world(np.array([route.at(along + speed * 0.5 * k)[:2] for k in range(1, 7)]))
            state = step_bicycle(CAR, state, controller.control(CAR, state, plan, 0.5), 0.25)
            left.append(route.nearest(state.x_m, state.y_m).left_m)
        assert np.abs(left).max() < error_m and np.abs(left[40:]).max() < settled_m
        assert state.speed_m_s == pytest.approx(speed, abs=0.05)


def stopped(controller, state, steps=40, noise=0.0):
    """Ask for a full stop at every step; returns all states."""
    random, states = np.random.default_rng(0), [state]
    for _ in range(steps):
        plan = noise * random.normal(size=(6, 2))
        states.append(step_bicycle(CAR, states[-1], controller.control(CAR, states[-1], plan, 0.5), 0.25))
    return states


@pytest.mark.parametrize("steer", [0.0, 0.2])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_full_stop_is_braked_straight(steer, noise):
    states = stopped(tracker(), VehicleState(0.0, 0.0, 0.0, 8.0, steer), noise=noise)
    end = states[-1]
    assert states[10].x_m == pytest.approx(8.0**2 / (2 * 3), abs=0.2)
    assert all(abs(state.steer_rad) <= steer + 0.01 for state in states)
    assert end.speed_m_s == 0.0 and abs(end.steer_rad) < 0.01 and abs(end.yaw_rad) < (0.2 if steer else 0.01)
    held = stopped(tracker(), end, steps=10)[-1]
    assert (held.x_m, held.y_m, held.speed_m_s) == pytest.approx((end.x_m, end.y_m, 0.0), abs=1e-9)


@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.floats(-60, 60), st.floats(-60, 60)), min_size=1, max_size=8),
    st.floats(0, 50),
    st.floats(-1.047, 1.047),
    st.sampled_from(
        [{"heading_reference": "tangent"}, {"heading_reference": "hugsim"}, {"kind": "pure-pursuit"}],
    ),
)
def test_whatever_is_planned_controls_are_finite_and_the_trackers_within_limits(plan, speed, steer, fields):
    controller = tracker(**fields)
    assert isinstance(controller, controller_base.Controller)
    control = controller.control(CAR, VehicleState(0.0, 0.0, 0.0, speed, steer), np.array(plan, np.float64), 0.5)
    assert np.isfinite(control).all()
    if "kind" not in fields:
        assert abs(control.acceleration_m_s2) <= 3.0 and abs(control.steer_rate_rad_s) <= 0.4 + 1e-12
