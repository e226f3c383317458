"""Gymnasium environments: gymnasium's own checker, rewards and ends worked out by hand, and equal episodes."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.simulation.gymnasium import (
    CONTROL_ID,
    MAX_ROAD_USERS,
    PLAN_ID,
    DriveEnvironment,
    Reward,
    register_environments,
)
from gsrain_engine.simulation.vehicle import Vehicle
from simulation import small_drive
from small_scene import small_scene

SCENE = small_scene()
LEAD = {"id": "lead", "model": "saloon", "ahead_m": 25.0, "behaviour": {"kind": "stationary"}}
EVERYTHING = {"cameras": ("front",), "depth": True, "semantic": True, "render_mode": "rgb_array", "intensity_mm_h": 8.5}


def scenario(**fields):
    return small_drive.scenario(**{"speed_m_s": 2.0, "picture_width_px": 64, "duration_s": 2.0, **fields})


def environment(fields=None, **options) -> DriveEnvironment:
    made = DriveEnvironment(scenario(**(fields or {})), SCENE, **options)
    if not options.get("cameras"):
        made.reset(seed=0)
    return made


@pytest.mark.parametrize(("id", "shape", "options"), [(CONTROL_ID, (2,), EVERYTHING), (PLAN_ID, (6, 2), {})])
def test_gymnasiums_checker_finds_nothing(id, shape, options):
    register_environments()  # as the import has done already: no warning
    made = gymnasium.make(id, scenario=scenario(road_users=[LEAD]), scene=SCENE, backend="cpu", **options)
    assert isinstance(made.unwrapped, DriveEnvironment) and made.action_space.shape == shape
    assert ({"rgb", "depth", "semantic"} <= set(made.observation_space.spaces)) == bool(options)
    check_env(made.unwrapped)


def test_the_same_seed_and_actions_are_the_same_episode_and_others_differ_in_their_rain():
    def episode(seed):
        fields = {"rain": RainSettings(haze="gaussians")}  # drops of a small image are all far
        env = environment(fields, cameras=("front",), intensity_mm_h=12.0, backend="cpu")
        observations = [env.reset(seed=seed)[0], *(env.step(np.array([0.5, 0.1]))[0] for _ in range(2))]
        env.close()
        return [(each["rgb"]["FRONT"].tobytes(), each["ego"].tobytes()) for each in observations]

    assert episode(7) == episode(7) and episode(7)[0] != episode(8)[0]
    env = environment(render_mode="rgb_array", backend="cpu")  # renders the front camera without observing it
    seeds = [[env.reset(seed=each)[1]["seed"] for each in (1, None, None)] for _ in range(2)]
    assert len(set(seeds[0])) == 3 and seeds[0] == seeds[1]
    assert "rgb" not in env.reset()[0] and env.render().shape == (42, 64, 3) and env.render().std() > 10
    env.close()
    assert environment().render() is None


def test_controls_and_plans_move_it_and_progress_is_rewarded():
    observed, reward, terminated, truncated, info = environment().step(np.array([1.0, 0.0], np.float32))
    ahead = 2.0 * 0.25 + 0.5 * 3.0 * 0.25**2
    assert info["pose"][0] == pytest.approx(ahead)
    assert observed["ego"][:2] == pytest.approx([2.75, 3.0])
    assert observed["route"][0] == pytest.approx([2.0, 0.0], abs=1e-6)
    assert reward == pytest.approx(ahead - 0.05 * 3.0**2 * 0.25) and not terminated and not truncated
    env = environment(action="plan")
    for _ in range(4):
        observed, *_ = env.step(np.stack([1.5 * np.arange(1, 7), np.zeros(6)], axis=1))
    assert 2.1 < observed["ego"][0] < 3.0


@pytest.mark.parametrize(
    ("fields", "action", "rewards", "end"),
    [
        ({"road_users": [{**LEAD, "ahead_m": 8.0}], "speed_m_s": 10.0}, (0, 0), [0.0, -9.0], "collision"),
        ({"duration_s": 0.5}, (0, 0), [0.0, 0.0], "time"),
        ({"speed_m_s": 30.0}, (0, 0), [0.0, 7.0], "completed"),
        ({"left_m": 0.45, "leave_m": 0.5, "speed_m_s": 5.0}, (0, 1), [0.0, -5.0], "off route"),
    ],
)
def test_ends_terminate_or_truncate_with_their_reward(fields, action, rewards, end):
    env = environment(fields, reward=Reward(collision=-9, completed=7, off_route=-5, discomfort=0, progress=0))
    steps = [env.step(np.array(action, float)) for _ in range(2)]
    assert [each[1] for each in steps] == rewards
    assert [each[2:4] for each in steps] == [(False, False), (end != "time", end == "time")]
    assert steps[-1][4]["end"] == end
    with pytest.raises(ValueError, match=end):
        env.step(np.zeros(2))


def test_the_nearest_road_users_are_observed_up_to_the_limit():
    users = [{**LEAD, "id": str(k), "ahead_m": 60.0 - k, "left_m": 5.0} for k in range(MAX_ROAD_USERS + 4)]
    for given in (users, users[:1]):
        env = environment({"road_users": given})
        observed, _ = env.reset(seed=0)
        count = min(len(given), MAX_ROAD_USERS)
        assert observed["road_user_count"] == count and observed in env.observation_space
        rows, nearest = observed["road_users"], 60 + Vehicle().middle_m - len(given) + 1
        assert rows[0, :3] == pytest.approx([nearest, 5.0, 0.0], abs=1e-5)
        assert (np.diff(rows[:count, 0]) > 0).all() and not rows[count:].any()


def test_wrong_actions_and_options_are_refused_by_name():
    env = environment()
    for action in (np.zeros(3), np.array([np.nan, 0])):
        with pytest.raises(ValueError, match="action"):
            env.step(action)
    with pytest.raises(ValueError, match="reset"):
        DriveEnvironment(scenario(), SCENE).step(np.zeros(2))
    for options, word in (
        ({"intensity_mm_h": 200.0}, "intensity_mm_h"),
        ({"cameras": ("BACK",), "backend": "cpu"}, "BACK"),
        ({"render_mode": "human"}, "render_mode"),
    ):
        with pytest.raises(ValueError, match=word):
            environment(**options)
