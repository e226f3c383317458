"""Planned-point and planned-frame collision rates, worked out by hand."""

from fractions import Fraction

import numpy as np
import pytest

from gsrain_engine.simulation.metrics.collisions import (
    LoggedTraffic,
    PlannedCollisions,
    ego_box,
    planned_collisions,
    planned_poses,
    with_start,
)
from small_rollout import CAR, ego, rollout, step, straight, user


def test_box_stands_ahead_of_the_rear_axle():
    box = ego_box(CAR, np.array([10.0, 5.0, np.pi / 2]))
    assert (box.x_m, box.y_m) == pytest.approx((10.0, 6.0))
    assert (box.length_m, box.width_m) == (4.0, 2.0)


def test_headings_look_to_the_next_point():
    moment = step(0, ego(100.0, 50.0, np.pi / 2), plan=[(5, 0), (10, 0), (10, 5)])
    poses = planned_poses(moment)
    assert poses[:, :2] == pytest.approx(np.array([[100, 55], [100, 60], [95, 60]]))  # ahead is +y, left is -x
    assert poses[:, 2] == pytest.approx([np.pi / 2, np.pi, np.pi])
    hugsim = planned_poses(moment, "hugsim")
    assert hugsim == pytest.approx(poses[:2])
    assert with_start(moment, hugsim)[0] == pytest.approx([100, 50, np.pi / 2])


def test_a_plan_that_stands_has_the_heading_of_the_vehicle():
    jitter = [(0.3, 0.0), (0.2, 0.2), (0.3, -0.3), (0.4, 0.1)]
    for reading in ("all", "hugsim"):
        assert (planned_poses(step(0, ego(yaw=0.7), plan=jitter), reading)[:, 2] == 0.7).all()


def test_points_in_one_place_keep_the_heading_but_not_in_hugsim():
    stopping = [(3, 3), (6, 6), (6, 6), (6, 6)]
    moment = step(0, ego(), plan=stopping)
    assert planned_poses(moment)[:, 2] == pytest.approx([np.pi / 4] * 4)
    assert planned_poses(moment, "hugsim")[:, 2] == pytest.approx([np.pi / 4, 0, 0])


def test_one_of_six_points_is_in_the_standing_car():
    # The vehicle covers p - 1 .. p + 3, the car 19 .. 23; points at 5, 10, ... 30: only 20 is in it.
    run = rollout([step(0, ego(), [user(21.0)], straight(10)), step(1, ego(2.5), [user(21.0)])])
    every = planned_collisions(run)
    assert every.frames == ((False, False, False, True, False, False),)
    assert every.points_per_frame == 6
    assert every.point_rate == pytest.approx(1 / 6)
    assert every.frame_rate == 1.0
    assert planned_collisions(run, reading="hugsim").point_rate == pytest.approx(1 / 5)


def test_the_last_point_counts_only_where_all_do():
    run = rollout([step(0, ego(), [user(32.0)], straight(10)), step(1, ego(2.5), [user(32.0)])])
    assert planned_collisions(run).frame_rate == 1.0
    assert planned_collisions(run, reading="hugsim").frame_rate == 0.0


def test_futures_are_where_others_really_were():
    # The other crosses at 10 m/s: it is on the way (y = 0) at 1.0 s only, when the plan is at 10.
    moments = [step(i, ego(2.5 * i), [user(11.0, 10.0 * (0.25 * i - 1.0), 10.0, np.pi / 2)]) for i in range(13)]
    moments[0] = step(0, ego(), moments[0].road_users, straight(10))
    assert planned_collisions(rollout(moments)).frames == ((False, True, False, False, False, False),)
    # Half a second later it has gone when the plan comes by.
    late = [step(i, ego(2.5 * i), [user(11.0, 10.0 * (0.25 * i - 0.5), 10.0, np.pi / 2)]) for i in range(13)]
    late[0] = step(0, ego(), late[0].road_users, straight(10))
    assert planned_collisions(rollout(late)).frame_rate == 0.0


def test_beyond_the_end_everybody_stays_where_they_were_last():
    moments = [step(0, ego(), [user(100.0)], straight(10)), step(1, ego(2.5), [user(31.0)])]
    assert planned_collisions(rollout(moments)).frames == ((False, False, False, False, False, True),)


def test_between_two_moments_others_are_between_them():
    moments = [step(i, ego(), [user(3.0 * i, yaw=(3.1, -3.1, 3.1)[i])], step_s=0.2) for i in range(3)]
    traffic = LoggedTraffic(rollout(moments, step_s=0.2))
    assert traffic.at(0.1)[0].x_m == pytest.approx(1.5)
    assert abs(traffic.at(0.1)[0].yaw_rad) == pytest.approx(np.pi)  # the short way round
    assert abs(traffic.at(0.3)[0].yaw_rad) == pytest.approx(np.pi)
    assert traffic.at(0.2)[0].x_m == 3.0
    assert traffic.at(9.0)[0].x_m == 6.0


def test_who_has_gone_is_not_there():
    moments = [step(0, ego(), [user(6.0)], straight(10)), step(1, ego(2.5)), step(2, ego(5.0))]
    assert planned_collisions(rollout(moments)).frame_rate == 0.0


class Wall:
    """Stands across the way from x = 24 on."""

    def touches(self, box):
        return bool(box.corners[:, 0].max() >= 24)


def test_the_background_counts_where_it_is_known():
    run = rollout([step(0, ego(), plan=straight(10)), step(1, ego(2.5))])
    assert planned_collisions(run).point_rate == 0.0
    assert planned_collisions(run, Wall()).point_rate == pytest.approx(2 / 6)  # points at 25 and 30


def test_without_a_plan_there_is_no_rate():
    nothing = planned_collisions(rollout([step(0, ego()), step(1, ego())]))
    assert (nothing.point_rate, nothing.frame_rate, nothing.points_per_frame) == (None, None, 0)


@pytest.mark.parametrize(
    ("printed", "frames", "hits"),
    [("8.9", 56, 5), ("8.9", 56, 5), ("7.1", 42, 3), ("7.5", 40, 3), ("4.9", 41, 2), ("7.3", 41, 3)],
)
def test_the_papers_printed_rates_are_shares_of_frames(printed, frames, hits):
    by_frame = PlannedCollisions(((True,) + 4 * (False,),) * hits + ((False,) * 5,) * (frames - hits))
    assert by_frame.frame_rate is not None and f"{100 * by_frame.frame_rate:.1f}" == printed
    assert by_frame.point_rate == pytest.approx(hits / (5 * frames))
    whole = PlannedCollisions(((True,) * 5,) * hits + ((False,) * 5,) * (frames - hits))
    assert whole.point_rate is not None and Fraction(whole.point_rate).limit_denominator(1000) == Fraction(hits, frames)
    # One point more or less would not be printed so: by points, all five of a frame collide together.
    assert f"{100 * (5 * hits + 1) / (5 * frames):.1f}" != printed


def test_hugsim_reuses_the_last_place_that_it_has_met():
    # The run ends at 0.25 s, before the plan's first point: HUGSIM never meets the place of the end.
    moments = [step(0, ego(), [user(100.0)], straight(10)), step(1, ego(2.5), [user(11.0)])]
    assert planned_collisions(rollout(moments)).frames == ((False, True, False, False, False, False),)
    assert planned_collisions(rollout(moments), reading="hugsim").frame_rate == 0.0
    longer = [step(i, ego(2.5 * i), [user(100.0 if i < 2 else 11.0)]) for i in range(4)]
    longer[0] = step(0, ego(), [user(100.0)], straight(10))
    assert planned_collisions(rollout(longer), reading="hugsim").frames == ((False, True, False, False, False),)
