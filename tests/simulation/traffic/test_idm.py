"""The Intelligent Driver Model against what its equations give by hand."""

from itertools import pairwise

import numpy as np
import pytest

from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.traffic.base import LanePosition, find_vehicle_ahead
from simulation.traffic.on_the_road import STRAIGHT, car, moves, settings


def test_on_a_free_road_it_accelerates_by_one_less_the_fourth_power():
    idm = settings(kind="idm", desired_speed_m_s=20.0, acceleration_m_s2=2.0)
    assert idm.acceleration(0.0, None) == pytest.approx(2.0)
    assert idm.acceleration(10.0, None) == pytest.approx(2.0 * (1 - 1 / 16))
    assert idm.acceleration(20.0, None) == pytest.approx(0.0)
    assert idm.acceleration(25.0, None) < 0


def test_the_interaction_by_hand():
    """HUGSIM's values, 10 m/s, 40 m to one that stands: s* = 5 + 20 + 100 / (2 sqrt 8) = 42.678."""
    idm = settings(kind="idm", desired_speed_m_s=30.0, least_gap_m=5.0, headway_s=2.0, acceleration_m_s2=2.0,
                   comfortable_braking_m_s2=4.0)  # fmt: skip
    wanted = 5 + 20 + 100 / (2 * np.sqrt(8))
    assert idm.acceleration(10.0, 40.0, 10.0) == pytest.approx(2 * (1 - (1 / 3) ** 4 - (wanted / 40) ** 2))
    assert idm.acceleration(10.0, 1.0, 10.0) == -8.0  # no harder than it can


def test_it_settles_at_the_equilibrium_gap():
    """At equal speeds and no acceleration: gap = (s0 + v T) / sqrt(1 - (v / v0)^4)."""
    idm = settings(kind="idm", desired_speed_m_s=15.0)
    last = moves(idm, car(0, speed=8), 90.0, others=[car(30, speed=8.0)], dt_s=0.5)[-1]
    gap = 30 + 8 * 90 - last.x_m - 4.0
    assert gap == pytest.approx((2.0 + 8.0) / np.sqrt(1 - (8 / 15) ** 4), abs=0.05)
    assert last.speed_m_s == pytest.approx(8.0, abs=0.01)


def test_it_stops_behind_one_that_stands_and_never_rolls_back():
    seen = moves(settings(kind="idm"), car(0, speed=12), 40.0, others=[car(80)])
    assert seen[-1].speed_m_s < 0.1
    assert 0.5 < 80 - seen[-1].x_m - 4.0 < 2.5
    assert all(later.x_m >= earlier.x_m for earlier, later in pairwise(seen))


def test_it_yields_to_the_ego_vehicle_too():
    free = moves(settings(kind="idm"), car(0, speed=10), 3.0)[-1]
    behind = moves(settings(kind="idm"), car(0, speed=10), 3.0, ego=car(15, speed=5, id="ego"))[-1]
    assert behind.speed_m_s < free.speed_m_s - 1


@pytest.mark.parametrize(("y", "matters"), [(0.0, True), (1.9, True), (2.1, False), (-3.4, False)])
def test_only_who_overlaps_its_lane_matters(y, matters):
    assert (find_vehicle_ahead(STRAIGHT, car(0), (car(20, y),)) is not None) == matters


def test_who_stands_across_takes_up_its_length():
    assert find_vehicle_ahead(STRAIGHT, car(0), (car(20, 2.9, yaw=np.pi / 2),)).gap_m == pytest.approx(20 - 2 - 1)


def test_the_nearest_is_followed_and_nobody_behind():
    ahead = find_vehicle_ahead(STRAIGHT, car(50, speed=9), (car(90), car(70, speed=3), car(40, speed=30)))
    assert (ahead.gap_m, ahead.speed_m_s) == (pytest.approx(16.0), pytest.approx(3.0))


def test_it_drives_against_the_route_where_it_heads_so():
    seen = moves(settings(kind="idm"), car(100, 3.4, 10, np.pi), 4.0, others=[car(40, 3.4, 0, np.pi)])
    assert seen[-1].x_m < 75
    assert seen[-1].y_m == pytest.approx(3.4)
    assert seen[-1].speed_m_s < 10
    assert np.cos(seen[-1].yaw_rad) == pytest.approx(-1.0)
    assert find_vehicle_ahead(STRAIGHT, seen[0], (car(40, 3.4, 2.0, 0.0),)).speed_m_s == pytest.approx(-2.0)


def test_it_follows_the_bends_of_the_route_in_its_own_lane():
    turn = np.linspace(0, np.pi, 200)
    bend = Route(np.stack([50 * np.sin(turn), 50 * (1 - np.cos(turn))], axis=1))
    start = car(0.0, 3.4, 8.0)
    seen = moves(settings(kind="idm", desired_speed_m_s=8.0), start, 12.0, route=bend)
    away = [np.hypot(each.x_m, each.y_m - 50) for each in seen]
    np.testing.assert_allclose(away, 46.6, atol=0.02)
    steps = [np.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in pairwise(seen)]
    np.testing.assert_allclose(steps, 2.0, atol=0.01)
    assert seen[-1].yaw_rad == pytest.approx(96 / 46.6, abs=0.03)


def test_a_place_in_a_lane_and_back():
    place = LanePosition.of(STRAIGHT, car(20, -3, yaw=0.2))
    assert (place.along_m, place.left_m, place.direction) == (20.0, -3.0, 1)
    assert place.ahead(STRAIGHT, 5.0).along_m == pytest.approx(25.0)
    assert LanePosition.of(STRAIGHT, car(20, -3, yaw=3.0)).ahead(STRAIGHT, 5.0).along_m == pytest.approx(15.0)
