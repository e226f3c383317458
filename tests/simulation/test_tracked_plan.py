import numpy as np
import pytest

from gsrain_engine.simulation.controller_base import make_reachable, tracked_states

STAND = np.zeros((6, 2))


def headings(points, reference="tangent"):
    return tracked_states(np.array(points, np.float64), reference)[1:, 2]


def test_headings_are_half_way_between_the_steps():
    states = tracked_states(np.array([[2.0, 0], [4.0, 2.0], [4.0, 4.0]]), "tangent")
    np.testing.assert_allclose(states[:, 2], np.radians([0, 22.5, 67.5, 112.5]))
    np.testing.assert_array_equal(states[:, :2], [[0, 0], [2, 0], [4, 2], [4, 4]])


def test_headings_of_a_circle_go_on_beyond_half_a_turn():
    turn = np.linspace(0, 2 * np.pi, 13)[1:]
    found = headings(np.stack([10 * np.sin(turn), 10 * (1 - np.cos(turn))], axis=1))
    np.testing.assert_allclose(found, turn, atol=1e-9)


def test_a_standing_plan_keeps_the_present_heading_and_a_stop_the_last():
    assert list(headings(STAND)) == [0] * 6
    assert list(headings([[0.01, 0.04], [-0.02, 0.03]])) == [0, 0]
    np.testing.assert_allclose(headings([[2, 2], [2.01, 1.99], [1.9, 1.9]]), [np.pi / 4] * 3)
    assert list(headings([[3.0, 0.0]])) == [0.0]


def test_hugsims_heading_is_folded_and_to_the_right():
    straight = headings([[2.5, 0], [5, 0]], "hugsim")
    assert straight == pytest.approx([-np.pi / 2] * 2)  # to its right, which is negative here
    assert headings([[2.5, 2.5]], "hugsim") == pytest.approx([np.pi / 4])
    assert headings([[2.5, 0.01]], "hugsim") == pytest.approx([np.pi / 2], abs=0.01)
    assert headings([[0.0, 0.0]], "hugsim") == pytest.approx([0.0])


def test_what_can_be_kept_is_kept():
    plan = np.cumsum([[4.0, 0.1], [3.5, 0.2], [3.0, 0.3]], axis=0)
    found = make_reachable(plan, 8.0, 3.0, 0.5)
    assert not found[1]
    np.testing.assert_array_equal(found[0], plan)


def test_a_full_stop_is_straight_on_to_the_end_of_full_braking():
    found = make_reachable(STAND, 8.0, 4.0, 0.5)
    assert found[1]
    np.testing.assert_allclose(found[0][:, 1], 0, atol=1e-12)
    np.testing.assert_allclose(found[0][:, 0], [3.5, 6.0, 7.5, 8.0, 8.0, 8.0])


def test_a_stop_round_a_corner_goes_on_behind_the_corner():
    plan = np.array([[1.0, 0], [2.0, 0], [2.0, 1.0], [2.0, 1.0]])
    found = make_reachable(plan, 4.0, 2.0, 0.5)
    assert found[1]
    # 1.75, 3 (at the plan's end), 3.75 and 4 m of way: the last two beyond the end, as it pointed
    np.testing.assert_allclose(found[0], [[1.75, 0], [2, 1], [2, 1.75], [2, 2]], atol=1e-12)


def test_standing_still_nothing_is_moved():
    found = make_reachable(STAND, 0.0, 3.0, 0.5)
    assert not found[1]
    np.testing.assert_array_equal(found[0], STAND)
