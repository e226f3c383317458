"""Time to collision and gaps, worked out by hand."""

import numpy as np
import pytest

from gsrain_engine.simulation.metrics.collisions import first_collision, gaps_m, times_to_collision_s
from small_rollout import approach, ego, rollout, step, user


def _one(users, own=None, collision=None):
    return rollout([step(0, own or ego(), users, collision=collision)])


def _ttc(users, own=None, distance="bumper"):
    return float(times_to_collision_s(_one(users, own), distance)[0])


def test_bumper_gap_over_closing_speed():
    # Front bumper at 3, rear bumper of the other at 19: 16 m, closing by 6 m/s.
    assert gaps_m(_one([user(21.0, speed=4.0)]))[0] == pytest.approx(16.0)
    assert _ttc([user(21.0, speed=4.0)]) == pytest.approx(16 / 6)


def test_bumpers_that_touch_have_no_time_left_at_any_speed():
    assert _ttc([user(5.0, speed=10.0)]) == _ttc([user(5.0, speed=12.0)], distance="center") == 0.0
    assert _ttc([user(5.001, speed=12.0)]) == 10.0


def test_who_overlaps_only_the_rear_is_there_too_and_who_is_behind_is_not():
    """The own box begins 1 m behind the rear axle; the other one's reaches 2 m ahead of its middle."""
    assert _ttc([user(-2.7, speed=10.0)]) == gaps_m(_one([user(-2.7)]))[0] == 0.0
    assert _ttc([user(-3.1, speed=10.0)]) == 10.0 and np.isinf(gaps_m(_one([user(-3.1)]))[0])


def test_middles_are_farther_apart_than_bumpers():
    assert _ttc([user(21.0, speed=4.0)], distance="center") == pytest.approx((21 - 1) / 6)


def test_no_risk_is_ten_seconds():
    assert _ttc([user(21.0, speed=10.0)]) == 10.0
    assert _ttc([user(21.0, speed=12.0)]) == 10.0
    assert _ttc([]) == 10.0
    assert _ttc([user(160.0)]) == 10.0  # 155 m at 10 m/s are longer than that
    assert np.isinf(gaps_m(_one([]))[0])


def test_who_comes_towards_it_closes_faster():
    assert _ttc([user(48.0, speed=5.0, yaw=np.pi)]) == pytest.approx(43 / 15)


def test_who_crosses_counts_with_its_speed_along_the_heading():
    # It stands across the lane: 2 m wide along the heading, 4 m across.
    assert _ttc([user(14.0, speed=8.0, yaw=np.pi / 2)]) == pytest.approx(10 / 10)


@pytest.mark.parametrize(("left", "counts"), [(0.0, True), (1.9, True), (2.1, False), (-1.9, True), (-2.1, False)])
def test_only_who_overlaps_the_swept_lane_is_in_the_way(left, counts):
    assert (_ttc([user(21.0, left)]) == pytest.approx(1.6)) == counts
    assert np.isfinite(gaps_m(_one([user(21.0, left)]))[0]) == counts


def test_the_lane_turns_with_the_vehicle():
    assert _ttc([user(0.0, 21.0, yaw=np.pi / 2)], ego(yaw=np.pi / 2)) == pytest.approx(1.6)
    assert _ttc([user(21.0)], ego(yaw=np.pi / 2)) == 10.0


def test_a_turned_car_counts_from_where_it_enters_the_lane():
    # 45 degrees, its middle 3 m to the left: its nearest part within |y| <= 1 lies where its rear side crosses y = 1.
    corner = user(20.0, 3.0, yaw=np.pi / 4)
    # Corners at (20, 3) + R(45) (-2, -1) = (19.293, 0.879): the lowest corner is inside the lane.
    assert gaps_m(_one([corner]))[0] == pytest.approx(20 + (-2 + 1) / np.sqrt(2) - 3, abs=0.13)
    assert gaps_m(_one([corner]))[0] > 16.1


def test_who_is_behind_or_beside_is_no_risk():
    assert _ttc([user(-10.0, speed=20.0)]) == 10.0
    assert _ttc([user(1.0, 2.5)]) == 10.0


def test_nearest_time_wins_over_nearest_gap():
    near_but_slowly_closing, far_and_standing = user(15.0, speed=9.0), user(26.0, id="other")
    assert _ttc([near_but_slowly_closing, far_and_standing]) == pytest.approx(21 / 10)
    assert gaps_m(_one([near_but_slowly_closing, far_and_standing]))[0] == pytest.approx(10.0)


def test_overlap_and_collision_are_zero():
    assert _ttc([user(4.0)]) == 0.0
    assert times_to_collision_s(_one([], collision="background"))[0] == 0.0
    assert gaps_m(_one([user(4.0)]))[0] == 0.0


def test_a_run_into_a_standing_car():
    run = approach(speed=10.0, lead_x=40.0, moments=20)
    times = times_to_collision_s(run)
    assert times[0] == pytest.approx(3.5) and times[1] == pytest.approx(3.25) and times[-1] == 0.0
    hit = first_collision(run)
    assert hit is not None and (hit.who, hit.time_s, hit.closing_speed_m_s) == ("lead", 3.5, 10.0)
    assert first_collision(approach(moments=5)) is None


def test_closing_speed_is_what_the_other_does_not_drive_away_with():
    hit = first_collision(_one([user(5.0, speed=7.0)], collision="lead"))
    assert hit is not None and hit.closing_speed_m_s == pytest.approx(3.0) and hit.speed_m_s == 10.0
