"""The scripted cut-in: its quintic, its triggers, its speed."""

from itertools import pairwise

import msgspec
import numpy as np
import pytest

from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.traffic.base import changed_speed
from gsrain_engine.simulation.traffic.models import quintic, quintic_rate
from simulation.traffic.on_the_road import car, moves, settings


def test_the_quintic_begins_and_ends_without_lateral_speed_or_acceleration():
    assert [quintic(u) for u in (0.0, 0.5, 1.0)] == [0.0, 0.5, 1.0]
    assert [quintic_rate(u) for u in (0.0, 1.0)] == [0.0, 0.0]
    assert quintic_rate(0.5) == pytest.approx(1.875)
    for u in (0.0, 1.0):  # second derivative, by differences of the first
        assert abs(quintic_rate(abs(u - 1e-6)) / 1e-6) < 1e-3
    shares = np.linspace(0, 1, 101)
    np.testing.assert_allclose(
        np.gradient([quintic(u) for u in shares], shares)[1:-1], [quintic_rate(u) for u in shares[1:-1]], atol=1e-3
    )


def test_it_changes_lane_in_its_time():
    seen = moves(settings(kind="cut-in", after_s=1.0, duration_s=2.0), car(10, 3.4, 5), 4.0)
    y = [each.y_m for each in seen]
    assert y[:5] == [3.4] * 5
    assert y[8] == pytest.approx(1.7)  # half way at half time
    np.testing.assert_allclose(y[12:], 0.0, atol=1e-12)
    assert [each.x_m for each in seen] == pytest.approx([10 + 5 * 0.25 * k for k in range(17)])
    assert all(later <= earlier for earlier, later in pairwise(y))


def test_it_heads_where_it_goes():
    seen = moves(settings(kind="cut-in", after_s=0.0, duration_s=2.0), car(0, 3.4, 5), 3.0, dt_s=0.01)
    x, y = (np.array([getattr(each, axis) for each in seen]) for axis in ("x_m", "y_m"))
    heading = np.arctan2(np.gradient(y), np.gradient(x))
    np.testing.assert_allclose([each.yaw_rad for each in seen][2:-2], heading[2:-2], atol=2e-3)
    assert min(heading) == pytest.approx(-np.arctan(3.4 * 1.875 / 2 / 5), abs=1e-3)
    speeds = np.hypot(np.gradient(x), np.gradient(y)) / 0.01
    np.testing.assert_allclose([each.speed_m_s for each in seen][2:-2], speeds[2:-2], atol=5e-3)


def test_an_offset_goes_so_far_whatever_the_route():
    seen = moves(settings(kind="cut-in", after_s=0.0, offset_m=-2.0), car(0, 3.4, 5), 4.0)
    assert seen[-1].y_m == pytest.approx(1.4)


def test_it_brakes_to_a_speed():
    cut_in = settings(kind="cut-in", after_s=1.0, to_speed_m_s=1.0, acceleration_m_s2=2.0)
    seen = moves(cut_in, car(0, 3.4, 5), 6.0)
    # 5 m at 5 m/s, 2 s from 5 to 1 m/s, 3 s at 1 m/s
    assert seen[-1].x_m == pytest.approx(5 + 6 + 3)
    assert seen[-1].speed_m_s == pytest.approx(1.0)


def test_it_brakes_some_time_after_it_has_set_out():
    fields = {"after_s": 1.0, "speed_delay_s": 1.5, "to_speed_m_s": 0.0, "acceleration_m_s2": 5.0}
    seen = moves(settings(kind="cut-in", **fields), car(0, 3.4, 5), 6.0)
    assert seen[10].x_m == pytest.approx(12.5)
    assert seen[-1].x_m == pytest.approx(12.5 + 2.5)
    assert seen[-1].y_m == pytest.approx(0.0)


def test_the_change_of_speed_by_hand():
    assert changed_speed(5.0, 1.0, 2.0, 1.0) == (3.0, 4.0)
    assert changed_speed(2.0, 0.0, 4.0, 2.0) == (0.0, 0.5)
    assert changed_speed(2.0, 3.0, 2.0, 1.0) == (3.0, 0.5 * 2.5 + 0.5 * 3.0)
    assert changed_speed(3.0, 3.0, 2.0, 2.0) == (3.0, 6.0)


def began(seen):
    return next(k for k, each in enumerate(seen) if each.y_m != seen[0].y_m) * 0.25 - 0.25


def test_a_gap_that_shrinks_sets_it_off():
    """The ego vehicle is 20 m behind (16 m from bumper to bumper) and 4 m/s faster: 12 m are reached after 1 s."""
    seen = moves(settings(kind="cut-in", gap_m=12.0), car(20, 3.4, 5), 4.0, ego=car(0, 0, 9, id="ego"))
    assert began(seen) == 1.0


def test_a_gap_that_grows_sets_it_off():
    """Overtaking: 8 m ahead (4 m between bumpers), 4 m/s faster: 10 m between bumpers after 1.5 s."""
    seen = moves(settings(kind="cut-in", gap_m=10.0), car(8, 3.4, 9), 4.0, ego=car(0, 0, 5, id="ego"))
    assert began(seen) == 1.5


def test_a_time_to_collision_sets_it_off():
    """16 m between bumpers, closing by 4 m/s: 2 s are left after 2 s."""
    cut_in = settings(kind="cut-in", time_to_collision_s=2.0)
    assert began(moves(cut_in, car(20, 3.4, 5), 4.0, ego=car(0, 0, 9, id="ego"))) == 2.0
    slower = moves(cut_in, car(20, 3.4, 5), 4.0, ego=car(0, 0, 4, id="ego"))
    assert slower[-1].y_m == 3.4
    passed = moves(cut_in, car(0, 3.4, 5), 4.0, ego=car(6, 0, 9, id="ego"))
    assert passed[-1].y_m == 3.4


@pytest.mark.parametrize("triggers", [{}, {"after_s": 1.0, "gap_m": 3.0}])
def test_exactly_one_trigger_is_wanted(triggers):
    with pytest.raises(msgspec.ValidationError, match="exactly one of `after_s`, `gap_m` and `time_to_collision_s`"):
        settings(kind="cut-in", **triggers)


def test_in_a_bend_it_ends_on_the_route():
    turn = np.linspace(0, np.pi / 2, 200)
    bend = Route(np.stack([60 * np.sin(turn), 60 * (1 - np.cos(turn))], axis=1))
    last = moves(settings(kind="cut-in", after_s=0.5), car(0, 3.4, 8), 6.0, route=bend)[-1]
    assert np.hypot(last.x_m, last.y_m - 60) == pytest.approx(60, abs=0.01)


def test_twice_the_same():
    run = [moves(settings(kind="cut-in", gap_m=12.0), car(20, 3.4, 5), 5.0, ego=car(0, 0, 9, id="ego")) for _ in "ab"]
    assert run[0] == run[1]
