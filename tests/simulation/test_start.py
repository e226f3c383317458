from dataclasses import replace

import msgspec
import numpy as np
import pytest

from curved_scene import RADIUS_M, curved_scene
from gsrain_engine.simulation.ground import recorded_route
from gsrain_engine.simulation.scenario import Scenario, start_place, start_state
from gsrain_engine.simulation.simulation import Simulation
from small_scene import small_scene

SCENE = curved_scene()
ROUTE = recorded_route(SCENE)


def scenario(**fields) -> Scenario:
    return msgspec.convert({"name": "test", **fields}, Scenario)


def user(**fields):
    plain = {"id": "other", "ahead_m": 10.0, "behaviour": {"kind": "stationary"}, **fields}
    return scenario(road_users=[plain]).road_users[0]


def test_the_ego_vehicle_starts_where_it_was_recorded_or_so_far_from_there():
    state = start_state(scenario(speed_m_s=3.0), SCENE, ROUTE)
    assert (state.x_m, state.y_m, state.speed_m_s) == pytest.approx((0.0, 0.0, 3.0), abs=1e-6)
    turned = 20.0 / RADIUS_M
    moved = start_state(scenario(ahead_m=20.0, left_m=-2.0, turned_deg=10.0), SCENE, ROUTE)
    place = (RADIUS_M + 2) * np.sin(turned), RADIUS_M - (RADIUS_M + 2) * np.cos(turned)
    assert (moved.x_m, moved.y_m) == pytest.approx(place, abs=0.05)
    assert moved.yaw_rad == pytest.approx(turned + np.radians(10), abs=0.03)


def test_a_road_user_is_placed_along_the_route_or_straight_ahead():
    test = scenario()
    ahead = test.vehicle.middle_m + 10.0
    x, y, heading = start_place(user(left_m=1.0), test, SCENE, ROUTE)
    turned = ahead / RADIUS_M
    assert (x, y) == pytest.approx(
        ((RADIUS_M - 1) * np.sin(turned), RADIUS_M - (RADIUS_M - 1) * np.cos(turned)), abs=0.05
    )
    assert heading == pytest.approx(turned, abs=0.03)
    x, y, heading = start_place(user(left_m=1.0, placed="straight", turned_deg=90.0), test, SCENE, ROUTE)
    ego = start_state(test, SCENE, ROUTE).yaw_rad
    assert ego.real < 0.05  # of the route's first piece
    assert (x, y) == pytest.approx((ahead * np.cos(ego) - np.sin(ego), ahead * np.sin(ego) + np.cos(ego)), abs=1e-9)
    assert heading == pytest.approx(ego + np.pi / 2)


def test_straight_is_seen_from_where_the_ego_vehicle_really_starts():
    test = scenario(ahead_m=5.0, left_m=2.0, turned_deg=90.0)
    scene = small_scene()
    x, y, heading = start_place(user(placed="straight"), test, scene, recorded_route(scene))
    assert (x, y, heading) == pytest.approx((5.0, 2.0 + 10.0 + test.vehicle.middle_m, np.pi / 2))


def test_the_simulation_starts_there():
    test = scenario(ahead_m=3.0, turned_deg=5.0, road_users=[msgspec.to_builtins(user(placed="straight"))])
    simulation = Simulation(test, SCENE)
    seen = simulation.reset()
    assert seen.state == start_state(test, SCENE, ROUTE)
    (there,) = seen.road_users
    assert (there.x_m, there.y_m, there.yaw_rad) == start_place(test.road_users[0], test, SCENE, ROUTE)


def test_a_scene_without_a_vehicle_at_that_time_is_said():
    with pytest.raises(ValueError, match="'curved' has no ego vehicle at 99 s"):
        start_state(scenario(start_s=99.0), replace(SCENE, ego=None), ROUTE)
    with pytest.raises(ValueError, match="has no drive to follow"):
        recorded_route(replace(SCENE, ego=None))
