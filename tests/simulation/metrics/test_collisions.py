"""Planned collisions, time to collision, gaps and HUGSIM's score, worked out by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.simulation.metrics import collisions
from gsrain_engine.simulation.metrics.hd_score import hd_score
from gsrain_engine.simulation.obstacles import CELL_M, Drivable, OccupiedSpace, cell_keys
from gsrain_engine.simulation.vehicle import VehicleState
from small_rollout import approach, ego, rollout, step, straight, user

# Planned poses


@pytest.mark.parametrize(
    ("own", "plan", "headings", "hugsim"),
    [
        (ego(yaw=np.pi / 2), [(5, 0), (10, 0), (10, 5)], [np.pi / 2, np.pi, np.pi], [np.pi / 2, np.pi]),
        # Plans that stand have the vehicle's heading; a repeated point keeps the one before it, but not in HUGSIM.
        (ego(yaw=0.7), [(0.3, 0.0), (0.2, 0.2), (0.3, -0.3), (0.4, 0.1)], [0.7] * 4, [0.7] * 3),
        (ego(), [(3, 3), (6, 6), (6, 6), (6, 6)], [np.pi / 4] * 4, [np.pi / 4, 0, 0]),
        (ego(), [(1.05, -0.2), (1.05, 0.0)], [np.pi / 2] * 2, [np.pi / 2]),  # a meter is enough
        (ego(), [(6.0, 6.0), (6.0, 6.011), (6.009, 6.011)], [np.pi / 2] * 3, [np.pi / 2, 0]),  # a centimeter is enough
    ],
)
def test_headings_look_to_the_next_point(own, plan, headings, hugsim):
    moment = step(0, own, plan=plan)
    places = VehicleState(own.x_m, own.y_m, own.yaw_rad).to_world(np.array(plan, np.float64))
    for reading, expected in (("all", headings), ("hugsim", hugsim)):
        poses = collisions.planned_poses(moment, reading)
        np.testing.assert_allclose(poses, np.column_stack([places[: len(expected)], expected]), atol=1e-12)


# Planned collisions


def wall(x_m):
    """Stands across the road from a distance on."""
    x, y = np.mgrid[x_m + CELL_M / 2 : 60 : CELL_M, -1:1:CELL_M]
    return OccupiedSpace(np.unique(cell_keys(np.stack([x.ravel(), y.ravel()], axis=1), CELL_M)))


def crossing(late_s):
    """Another crosses at 11 m at 10 m/s: it is on the road (y = 0) at a time; the plan is at 10 m after a second."""
    users = [user(11.0, 10.0 * (0.25 * i - late_s), 10.0, np.pi / 2) for i in range(13)]
    steps = [step(i, ego(2.5 * i), [each]) for i, each in enumerate(users)]
    return [step(0, ego(), [users[0]], straight(10)), *steps[1:]]


def two(first, *later):
    """A plan of 5, 10, ... 30 m among some users, and steps with others after it."""
    return [step(0, ego(), first, straight(10)), *(step(i, ego(2.5 * i), each) for i, each in enumerate(later, 1))]


@settings(max_examples=40)
@given(st.lists(st.tuples(*[st.floats(-2000, 2000)] * 2), min_size=1, max_size=20))
def test_cells_are_sorted_by_x_then_y_and_return_their_places(points):
    cells = np.unique(np.floor(np.array(points) / CELL_M), axis=0)
    space = OccupiedSpace(np.unique(cell_keys(np.array(points), CELL_M)))
    np.testing.assert_allclose(space.places, (cells + 0.5) * CELL_M)
    assert space.holds(np.array(points)).all() and not space.holds(cells[-1:] * CELL_M + [1.5 * CELL_M, 0]).any()


F, T = False, True


@pytest.mark.parametrize(
    ("steps", "wall_m", "hits", "hugsim"),
    [
        # The vehicle covers p - 1 .. p + 3, the car 19 .. 23: only the point at 20 is in it.
        (two([user(21.0)], [user(21.0)]), None, [F, F, F, T, F, F], [F, F, F, T, F]),
        (two([user(32.0)], [user(32.0)]), None, [F, F, F, F, F, T], [F] * 5),
        (crossing(1.0), None, [F, T, F, F, F, F], [F, T, F, F, F]),
        (crossing(0.5), None, [F] * 6, [F] * 5),
        # Beyond the end everybody stays where they were last; HUGSIM never meets that place.
        (two([user(100.0)], [user(31.0)]), None, [F, F, F, F, F, T], [F] * 5),
        (two([user(100.0)], [user(11.0)]), None, [F, T, F, F, F, F], [F] * 5),
        (two([user(100.0)], [user(100.0)], [user(11.0)], [user(11.0)]), None, [F, T, F, F, F, F], [F, T, F, F, F]),
        (two([user(6.0)], [], []), None, [F] * 6, [F] * 5),  # who has gone is not there
        (two([], []), 24, [F, F, F, F, T, T], [F, F, F, F, T]),
        ([step(0, ego()), step(1, ego())], None, [], []),
    ],
)
def test_points_that_collide(steps, wall_m, hits, hugsim):
    run, occupied = rollout(steps), None if wall_m is None else wall(wall_m)
    for reading, expected in (("all", hits), ("hugsim", hugsim)):
        found = collisions.planned_collisions(run, occupied, reading)
        assert found.frames == ((tuple(expected),) if expected else ()) and found.points_per_frame == len(expected)
        rates = (sum(expected) / len(expected), float(any(expected))) if expected else (None, None)
        assert (found.point_rate, found.frame_rate) == rates


def test_points_per_frame_are_those_of_the_longest_plan():
    assert collisions.PlannedCollisions(((F,), (F, T))).points_per_frame == 2


def test_between_two_moments_others_are_between_them_from_their_first_to_their_last():
    here = [user(4 + 3.0 * i, 9 - 2.0 * i, yaw=(3.1, -3.1, 3.1)[i]) for i in range(3)]
    moments = [step(i, ego(), users, step_s=0.2) for i, users in enumerate(([here[0]], [here[1]], [here[2]], []))]
    traffic = collisions.LoggedTraffic(rollout(moments, step_s=0.2))
    boxes = [box for time_s in (-1.0, 0.1, 0.2, 0.35, 0.4) for box in traffic.at(time_s)]
    assert np.array([(box.x_m, box.y_m) for box in boxes]) == pytest.approx(
        np.array([(4, 9), (5.5, 8), (7, 7), (9.25, 5.5), (10, 5)])
    )
    assert abs(boxes[1].yaw_rad) == pytest.approx(np.pi)  # the shorter turn
    assert traffic.at(0.5) == traffic.at(9.0) == ()


# Time to collision: the own box reaches from -1 to 3 m, another 2 m to either side of its middle


def measured(users, own=None, distance="bumper", collision=None):
    """Time to collision and gap."""
    run = rollout([step(0, own or ego(), users, collision=collision)])
    return float(collisions.times_to_collision_s(run, distance)[0]), float(collisions.gaps_m(run)[0])


@pytest.mark.parametrize(
    ("users", "ttc_s", "gap_m"),
    [
        ([user(21.0, speed=4.0)], 16 / 6, 16.0),
        ([user(21.0, speed=10.0)], 10.0, 16.0),  # no risk is ten seconds
        ([user(160.0)], 10.0, 155.0),
        ([], 10.0, np.inf),
        ([user(48.0, speed=5.0, yaw=np.pi)], 43 / 15, 43.0),  # oncoming
        ([user(14.0, speed=8.0, yaw=np.pi / 2)], 10 / 10, 10.0),  # across the lane
        ([user(5.0, speed=10.0)], 0.0, 0.0),  # bumpers that touch have no time left at any speed
        ([user(5.001, speed=12.0)], 10.0, 0.001),
        ([user(4.0)], 0.0, 0.0),
        ([user(-2.7, speed=10.0)], 0.0, 0.0),  # overlaps the rear
        ([user(-3.1, speed=20.0)], 10.0, np.inf),  # behind
        *(([user(21.0, left)], 1.6, 16.0) for left in (1.9, -1.9)),
        *(([user(21.0, left)], 10.0, np.inf) for left in (2.0, 2.1, -2.1)),
        # The nearest time counts, and the nearest gap.
        ([user(15.0, speed=9.0), user(26.0, id="other")], 21 / 10, 10.0),
        # 45 degrees: its side on x + y = 23 - sqrt(8) enters the lane at y = 1.
        ([user(20.0, 3.0, yaw=np.pi / 4)], (19 - np.sqrt(8)) / 10, 19 - np.sqrt(8)),
    ],
)
def test_time_to_collision_and_gap(users, ttc_s, gap_m):
    assert measured(users) == pytest.approx((ttc_s, gap_m), abs=1e-9)
    assert measured(users, collision="background")[0] == 0.0


@given(st.floats(6, 100), st.floats(0, 9), st.floats(-3, 3))
def test_middles_are_farther_apart_than_bumpers_and_the_lane_turns_with_the_vehicle(x, speed, yaw):
    there = user(x * np.cos(yaw), x * np.sin(yaw), speed, yaw)
    assert measured([there], ego(yaw=yaw))[0] == pytest.approx(min((x - 5) / (10 - speed), 10), rel=1e-6)
    center = measured([there], ego(yaw=yaw), "center")[0]
    assert center == pytest.approx(min((x - 1) / (10 - speed), 10), rel=1e-6)


def test_the_first_collision_of_a_run():
    assert collisions.first_collision(approach(speed=10.0, lead_x=40.0, moments=20)) == ("lead", 3.5, 10.0, 10.0)
    assert collisions.first_collision(approach(moments=5)) is None
    hit = rollout([step(0, ego(yaw=0.4), [user(5.0, speed=7.0, yaw=0.4 + np.pi / 3)], collision="lead")])
    assert collisions.first_collision(hit) == ("lead", 0.0, 10.0, pytest.approx(10 - 7 / 2))


# HUGSIM's HD-score


def frame(users, plan=None, completion=0.45):
    plan = straight(10.0) if plan is None else plan
    return rollout([step(0, ego(), users, plan), step(1, ego(2.5), users, completion=completion)])


@pytest.mark.parametrize(
    ("run", "occupied", "nc", "ttc", "c", "pdms"),
    [
        (frame([]), None, 1, 1, 1, 1.0),
        # Points 5 .. 25, moved on by 5 and 10 m: up to 35 m, a box up to 38 m. The car begins at 36 m.
        (frame([user(38.0)]), None, 1, 0, 1, 2 / 7),
        (frame([user(40.5)]), None, 1, 1, 1, 1.0),
        # It reaches 5 m at 10 m/s and goes on at 2 m/s: moved on by a second, that point is at 15 m, its front at 18 m.
        (frame([user(18.0)], [(5.0, 0.0), (6.0, 0.0), (7.0, 0.0)]), None, 1, 0, 1, 2 / 7),
        (frame([user(21.0)]), None, 0, 0, 1, 0.0),
        (frame([user(-2.0)]), None, 0, 1, 1, 0.0),  # at its rear bumper: the vehicle's own place counts as planned
        (frame([], straight(10.0, acceleration=-4.5)), None, 1, 1, 0, 5 / 7),
        (frame([], straight(10, points=3)), None, 1, 1, 1, 1.0),
        (frame([]), wall(30), 1, 0, 1, 2 / 7),  # the fifth point reaches 28 m
    ],
)
def test_parts_of_the_hd_score(run, occupied, nc, ttc, c, pdms):
    score = hd_score(run, occupied)
    assert (score.nc, score.ttc, score.c, score.frames, score.dac) == (nc, ttc, c, 1, None)
    assert (score.pdms, score.rc, score.hdscore) == pytest.approx((pdms, 0.45 / 0.9, pdms / 2))


@pytest.mark.parametrize(
    ("x_m", "y_m", "dac"),
    [(60, -5.0, 1.0), (60, 0.0, 1.0), (60, 0.25, 1.0), (26, 0.25, 0.0), (26, -5.0, 1.0), (-60, -5.0, 0.0)],
)
def test_drivable_area_counts_quarters_with_any_road(x_m, y_m, dac):
    """The road ends at x_m, and begins at y_m on its right; the last box counted reaches from 24 to 28 m."""
    x, y = np.mgrid[-60.125:x_m:0.25, y_m + 0.125 : 5 : 0.25]
    road = Drivable(np.unique(cell_keys(np.stack([x.ravel(), y.ravel()], axis=1), 0.25)))
    score = hd_score(frame([]), drivable=road)
    assert score.dac == score.pdms == dac


def test_scores_are_means_over_frames_and_nine_tenths_of_the_route_are_all_of_it():
    moments = [step(0, ego(), [user(38.0)], straight(10)), step(1, ego(2.5, speed=2.0), [user(38.0)], straight(2))]
    score = hd_score(rollout([*moments, step(2, ego(3.0), [user(38.0)], completion=0.95)]))
    assert (score.frames, score.ttc, score.rc) == (2, 0.5, 1.0) and score.pdms == pytest.approx((2 / 7 + 1) / 2)
    assert hd_score(frame([], straight(10, points=2))) is None  # one is left of two
    assert hd_score(rollout([step(0, ego())])) is None
