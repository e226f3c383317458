import subprocess
import sys

import gymnasium
import msgspec
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from gsrain_engine.simulation.gymnasium import (
    CONTROL_ID,
    MAX_ROAD_USERS,
    PLAN_ID,
    DriveEnvironment,
    Reward,
    control_of,
    register_environments,
)
from gsrain_engine.simulation.scenario import Scenario
from gsrain_engine.simulation.vehicle import Vehicle
from small_scene import small_scene

SCENE = small_scene()
LEAD = {"id": "lead", "model": "saloon", "ahead_m": 25.0, "behaviour": {"kind": "stationary"}}


def scenario(**fields) -> Scenario:
    plain = {"name": "test", "speed_m_s": 2.0, "picture_width_px": 64, "duration_s": 2.0, **fields}
    return msgspec.convert(plain, Scenario)


def environment(**options) -> DriveEnvironment:
    return DriveEnvironment(options.pop("scenario", scenario()), SCENE, **options)


def test_gymnasiums_checker_has_nothing_to_say():
    for id in (CONTROL_ID, PLAN_ID):
        made = gymnasium.make(id, scenario=scenario(road_users=[LEAD]), scene=SCENE, backend="cpu")
        check_env(made.unwrapped)


def test_gymnasiums_checker_has_nothing_to_say_with_everything_on():
    on = {"cameras": ("front",), "depth": True, "semantic": True, "render_mode": "rgb_array"}
    made = gymnasium.make(CONTROL_ID, scenario=scenario(), scene=SCENE, intensity_mm_h=8.5, backend="cpu", **on)
    assert set(made.observation_space.spaces) >= {"rgb", "depth", "semantic"}
    check_env(made.unwrapped)


def test_it_is_made_by_name():
    register_environments()  # as the import has done already: no warning
    made = gymnasium.make(CONTROL_ID, scenario=scenario(), scene=SCENE)
    assert isinstance(made.unwrapped, DriveEnvironment)
    assert made.action_space.shape == (2,)
    assert gymnasium.make(PLAN_ID, scenario=scenario(), scene=SCENE).action_space.shape == (6, 2)


def test_gymnasium_imports_it_by_its_module():
    code = (
        "import gymnasium; gymnasium.make('gsrain_engine.simulation.gymnasium:gsrain/Drive-v0', scenario='none-such')"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert "scenario none-such: no such file" in done.stderr


def test_the_same_seed_and_actions_are_the_same_episode():
    first, second = (_episode(environment(cameras=("front",), intensity_mm_h=12.0, backend="cpu"), 7) for _ in range(2))
    other = _episode(environment(cameras=("front",), intensity_mm_h=12.0, backend="cpu"), 8)
    assert len(first) == 3
    for one, same in zip(first, second, strict=True):
        np.testing.assert_array_equal(one["rgb"]["FRONT"], same["rgb"]["FRONT"])
        np.testing.assert_array_equal(one["ego"], same["ego"])
    assert (first[0]["rgb"]["FRONT"] != other[0]["rgb"]["FRONT"]).any()


def _episode(env, seed):
    seen = [env.reset(seed=seed)[0]]
    seen += [env.step(np.array([0.5, 0.1]))[0] for _ in range(2)]
    env.close()
    return seen


def test_episodes_without_a_seed_differ_in_their_rain():
    env = environment()
    env.reset(seed=1)
    seeds = [env.reset()[1]["seed"] for _ in range(3)]
    assert len(set(seeds)) == 3
    env.reset(seed=1)
    assert [env.reset()[1]["seed"] for _ in range(3)] == seeds


def test_the_pedal_and_the_wheel_are_shares_of_what_the_vehicle_can_do():
    car = Vehicle(most_acceleration_m_s2=2.0, most_braking_m_s2=6.0, most_steer_rate_rad_s=0.3)
    assert control_of(np.array([1.0, -1.0]), car) == (2.0, -0.3)
    assert control_of(np.array([-0.5, 0.5]), car) == (-3.0, 0.15)
    assert control_of(np.array([-9.0, 9.0]), car) == (-6.0, 0.3)


def test_it_moves_as_it_is_told():
    env = environment()
    env.reset(seed=0)
    seen, reward, terminated, truncated, info = env.step(np.array([1.0, 0.0], np.float32))
    way = 2.0 * 0.25 + 0.5 * 3.0 * 0.25**2
    assert info["pose"][0] == pytest.approx(way)
    assert seen["ego"][:2] == pytest.approx([2.75, 3.0])
    assert seen["route"][0] == pytest.approx([2.0, 0.0], abs=1e-6)
    assert (terminated, truncated) == (False, False)
    assert reward == pytest.approx(way - 0.05 * 3.0**2 * 0.25)


def test_a_plan_is_followed():
    env = environment(action="plan")
    env.reset(seed=0)
    for _ in range(4):
        seen, *_ = env.step(np.stack([1.5 * np.arange(1, 7), np.zeros(6)], axis=1))
    assert 2.1 < seen["ego"][0] < 3.0


def test_a_collision_terminates_and_costs():
    env = environment(scenario=scenario(road_users=[{**LEAD, "ahead_m": 8.0}], speed_m_s=10.0))
    seen, _ = env.reset(seed=0)
    assert seen["road_user_count"] == 1
    assert seen["road_users"][0, :3] == pytest.approx([8.0 + Vehicle().middle_m, 0, 0], abs=1e-5)
    assert not seen["road_users"][1:].any()
    rewards = []
    for _ in range(3):
        _, reward, terminated, truncated, info = env.step(np.zeros(2))
        rewards.append(reward)
        if terminated:
            break
    assert (terminated, truncated, info["end"]) == (True, False, "collision")
    assert rewards == pytest.approx([2.5, 2.5 - 100])
    with pytest.raises(ValueError, match="the drive is over"):
        env.step(np.zeros(2))


def test_time_truncates():
    env = environment(scenario=scenario(duration_s=0.5))
    env.reset(seed=0)
    assert env.step(np.zeros(2))[2:4] == (False, False)
    assert env.step(np.zeros(2))[2:4] == (False, True)


def test_the_end_of_the_route_and_leaving_it_terminate():
    reward = Reward(completed=7.0, off_route=-5.0, discomfort=0.0, progress=0.0)
    env = environment(scenario=scenario(speed_m_s=30.0), reward=reward)
    env.reset(seed=0)
    assert env.step(np.zeros(2))[1:3] == (0.0, False)
    assert env.step(np.zeros(2))[1:3] == (7.0, True)
    env = environment(scenario=scenario(left_m=0.45, leave_m=0.5, speed_m_s=5.0), reward=reward)
    env.reset(seed=0)
    found = [env.step(np.array([0.0, 1.0]))[1:3] for _ in range(2)]
    assert found == [(0.0, False), (-5.0, True)]


def test_more_road_users_than_there_is_room_for_are_the_nearest():
    users = [{**LEAD, "id": str(k), "ahead_m": 60.0 - k, "left_m": 5.0} for k in range(MAX_ROAD_USERS + 4)]
    env = environment(scenario=scenario(road_users=users))
    seen, _ = env.reset(seed=0)
    ahead = seen["road_users"][:, 0]
    assert seen["road_user_count"] == MAX_ROAD_USERS
    assert (np.diff(ahead) > 0).all()
    assert seen["road_users"][-1, 0] < 60 + Vehicle().middle_m - 3
    assert seen in env.observation_space


def test_what_is_wrong_is_said():
    env = environment()
    with pytest.raises(ValueError, match="reset it first"):
        env.step(np.zeros(2))
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"shape \(3,\): expected finite numbers \(2,\)"):
        env.step(np.zeros(3))
    with pytest.raises(ValueError, match="expected finite numbers"):
        env.step(np.array([np.nan, 0]))
    with pytest.raises(ValueError, match=r"intensity_mm_h: .* <= 100"):
        environment(intensity_mm_h=200.0)
    with pytest.raises(ValueError, match="needs camera BACK"):
        environment(cameras=("BACK",), backend="cpu")
    with pytest.raises(ValueError, match="only 'rgb_array'"):
        environment(render_mode="human")


def test_it_shows_the_front_camera_without_observing_it():
    env = environment(render_mode="rgb_array", backend="cpu")
    seen, _ = env.reset(seed=0)
    assert "rgb" not in seen
    picture = env.render()
    assert picture.shape == (42, 64, 3)
    assert picture.std() > 10
    assert environment().render() is None
    env.close()
