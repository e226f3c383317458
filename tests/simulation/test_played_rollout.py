"""A roll-out between its steps: everybody half way, turned the shorter way, and there until their last step is over."""

import msgspec
import numpy as np
import pytest

from gsrain_engine.simulation.playback import RolloutPlayback
from simulation.small_drive import driven, lead, scene_with_box

RIGHT, LEFT = -np.pi + 0.2, np.pi - 0.2
"""Headings on both sides of the cut."""


def turned(step, **fields):
    return msgspec.structs.replace(step, ego=msgspec.structs.replace(step.ego, **fields))


@pytest.fixture(scope="module")
def rollout():
    """A drive of a second at 4 m/s; its ego vehicle and its lead turn over the cut, and the lead goes at the end."""
    found = driven({"road_users": [lead(ahead_m=20.0)], "duration_s": 1.0, "start_s": 0.5}, scene_with_box())
    first, second, *rest = found.steps
    users = [msgspec.structs.replace(found.steps[0].road_users[0], yaw_rad=yaw) for yaw in (LEFT, RIGHT)]
    first = msgspec.structs.replace(turned(first, yaw_rad=LEFT), road_users=(users[0],))
    second = msgspec.structs.replace(turned(second, yaw_rad=RIGHT), road_users=(users[1],))
    rest[-1] = msgspec.structs.replace(rest[-1], road_users=())
    return msgspec.structs.replace(found, steps=(first, second, *rest))


@pytest.fixture(scope="module")
def played(rollout):
    return RolloutPlayback(rollout, scene_with_box())


def test_between_two_steps_everybody_is_between(played, rollout):
    first, second = (step.ego for step in rollout.steps[:2])
    half = played.state(0.125)
    assert half.x_m == pytest.approx((first.x_m + second.x_m) / 2) and second.x_m > first.x_m
    assert np.cos(half.yaw_rad) == pytest.approx(-1.0)  # not through 0, the longer way
    assert np.cos(played.users(0.125)[0].yaw_rad) == pytest.approx(-1.0)


def test_at_a_step_everybody_is_as_it_was_recorded(played, rollout):
    for step in rollout.steps:
        state = played.state(step.time_s)
        assert (state.x_m, state.y_m, state.speed_m_s) == (step.ego.x_m, step.ego.y_m, step.ego.speed_m_s)
        assert played.step(step.time_s) is step and played.step(step.time_s + 0.1) is step
        assert tuple(user.x_m for user in played.users(step.time_s)) == tuple(u.x_m for u in step.road_users)


def test_who_goes_is_there_until_the_step_is_over(played):
    assert played.end_s == 1.0
    assert [len(played.users(time_s)) for time_s in (0.75, 0.99, 1.0, 5.0)] == [1, 1, 0, 0]
    assert len(played.scene(0.9).actors) == 1 and played.scene(1.0).actors == ()


def test_before_its_start_and_after_its_end_it_stands(played):
    assert played.state(-1.0) == played.state(0.0) and played.state(9.0) == played.state(1.0)
    assert played.scene_time_s(0.25) == 0.75


def test_a_scenario_that_can_t_be_read_is_told_of(rollout):
    odd = msgspec.structs.replace(rollout, scenario={**rollout.scenario, "speed_m_s": -1.0})
    with pytest.raises(ValueError, match=r"the roll-out's scenario: Expected `float` >= 0.0 - at `\$.speed_m_s`"):
        RolloutPlayback(odd, scene_with_box())
