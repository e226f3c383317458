"""HUGSIM's HD-score and its parts, worked out by hand."""

import numpy as np
import pytest
from msgspec.structs import replace

from gsrain_engine.simulation.metrics.collisions import planned_collisions
from gsrain_engine.simulation.metrics.hd_score import hd_score
from small_rollout import approach, ego, rollout, step, straight, user


def _frame(users, plan=None, completion=0.45):
    plan = straight(10.0) if plan is None else plan
    return rollout([step(0, ego(), users, plan), step(1, ego(2.5), users, completion=completion)])


def test_a_free_road_scores_one_but_for_the_route():
    score = hd_score(_frame([]))
    assert score is not None
    assert (score.nc, score.ttc, score.c, score.pdms) == (1.0, 1.0, 1.0, 1.0)
    assert score.rc == pytest.approx(0.45 / 0.9) and score.hdscore == pytest.approx(0.5)
    assert score.dac is None and score.frames == 1


def test_nine_tenths_of_the_route_are_all_of_it():
    score = hd_score(_frame([], completion=0.95))
    assert score is not None and score.rc == 1.0


def test_what_comes_close_fails_the_time_to_collision_only():
    # Points 5 .. 25, moved on by 5 and 10 m: up to 35 m, a box up to 38 m. The car begins at 36 m.
    score = hd_score(_frame([user(38.0)]))
    assert score is not None
    assert (score.nc, score.ttc, score.c) == (1.0, 0.0, 1.0)
    assert score.pdms == pytest.approx(2 / 7)
    beyond = hd_score(_frame([user(40.5)]))
    assert beyond is not None and beyond.ttc == 1.0


def test_a_point_is_moved_on_at_the_speed_with_which_it_is_reached():
    # It reaches 5 m at 10 m/s and goes on at 2 m/s: moved on by a second, that point is at 15 m, its front at 18 m.
    score = hd_score(_frame([user(18.0)], [(5.0, 0.0), (6.0, 0.0), (7.0, 0.0)]))
    assert score is not None and (score.nc, score.ttc) == (1.0, 0.0)


def test_a_planned_collision_scores_nothing():
    score = hd_score(_frame([user(21.0)]))
    assert score is not None and (score.nc, score.pdms, score.hdscore) == (0.0, 0.0, 0.0)


def test_the_vehicles_own_place_counts_as_planned():
    touching = hd_score(_frame([user(-2.0)]))  # behind it, at its rear bumper
    assert touching is not None and touching.nc == 0.0


def test_discomfort_costs_two_sevenths():
    score = hd_score(_frame([], straight(10.0, acceleration=-4.5)))
    assert score is not None and (score.c, score.pdms) == (0.0, pytest.approx(5 / 7))


class Strip:
    """Road on one side of y = 0, or on some of the quarters."""

    def __init__(self, quarters):
        self.quarters = np.array(quarters, float)

    def share_on_road(self, box):
        return self.quarters


@pytest.mark.parametrize(
    ("quarters", "dac"),
    [([[1, 1], [1, 1]], 1.0), ([[0.01, 1], [0, 0]], 1.0), ([[0.4, 0], [0, 0]], 0.0), ([[0, 0], [0, 0]], 0.0)],
)
def test_drivable_area_counts_quarters_with_any_road(quarters, dac):
    score = hd_score(_frame([]), drivable=Strip(quarters))
    assert score is not None and score.dac == dac and score.pdms == dac


def test_scores_are_means_over_frames():
    moments = [step(0, ego(), [user(38.0)], straight(10)), step(1, ego(2.5, speed=2.0), [user(38.0)], straight(2))]
    score = hd_score(rollout([*moments, step(2, ego(3.0), [user(38.0)], completion=0.9)]))
    assert score is not None and score.frames == 2
    assert score.pdms == pytest.approx((2 / 7 + 1) / 2) and score.ttc == 0.5


def test_plans_of_two_points_do_not_count_and_none_is_no_score():
    assert hd_score(_frame([], straight(10, points=2))) is None  # one is left of two
    assert hd_score(rollout([step(0, ego())])) is None
    three = hd_score(_frame([], straight(10, points=3)))
    assert three is not None and three.c == 1.0


def test_background():
    class Wall:
        def touches(self, box):
            return bool(box.corners[:, 0].max() >= 30)

    score = hd_score(_frame([]), Wall())
    assert score is not None and (score.nc, score.ttc) == (1.0, 0.0)  # the fifth point reaches 28 m


def test_the_share_of_frames_is_hugsims():
    run = replace(approach(moments=20), end="collision")
    score = hd_score(run)
    assert score is not None
    assert planned_collisions(run, reading="hugsim").frame_rate == pytest.approx(1 - score.nc)
