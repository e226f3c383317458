"""Road users that stand, brake, or follow a track or an earlier drive."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.scene.scene import Actor, PoseTrack
from gsrain_engine.simulation.rollout import EgoRecord, Rollout, RolloutStep, UserModel, UserRecord
from gsrain_engine.simulation.rollout_io import write_rollout
from gsrain_engine.simulation.traffic.models import BehaviorSettings
from simulation.traffic.on_the_road import car, moves, settings
from small_scene import patch, small_scene


def test_straight_on():
    last = moves(settings(kind="constant-velocity"), car(0, 0, 6, 0.3), 2.0)[-1]
    assert (last.x_m, last.y_m) == (pytest.approx(12 * np.cos(0.3)), pytest.approx(12 * np.sin(0.3)))


def test_standing_stands_whatever_its_speed():
    last = moves(settings(kind="stationary"), car(7, 1, 6), 2.0)[-1]
    assert (last.x_m, last.y_m, last.speed_m_s) == (7.0, 1.0, 0.0)


def test_braking_takes_its_distance():
    """From 10 m/s at 6 m/s2: 100 / 12 m, after 2 s at 10 m/s; the stop lies between two steps."""
    last = moves(settings(kind="brake", after_s=2.0, deceleration_m_s2=6.0), car(0, 0, 10), 6.0)[-1]
    assert last.x_m == pytest.approx(20 + 100 / 12)
    assert last.speed_m_s == 0.0


def test_braking_never_speeds_up():
    last = moves(settings(kind="brake", after_s=0.0, to_speed_m_s=8.0), car(0, 0, 5), 3.0)[-1]
    assert last.speed_m_s == 5.0


def test_points_are_met_at_their_times_and_it_stands_after_the_last():
    points = [{"time_s": 1.0, "ahead_m": 5.0}, {"time_s": 3.0, "ahead_m": 9.0, "left_m": 2.0}]
    seen = moves(settings(kind="track", points=points), car(10, -1, 5), 5.0)
    assert (seen[4].x_m, seen[4].y_m) == (pytest.approx(15.0), pytest.approx(-1.0))
    assert (seen[12].x_m, seen[12].y_m) == (pytest.approx(19.0), pytest.approx(1.0))
    assert seen[-1].x_m == pytest.approx(19.0)
    assert seen[-1].speed_m_s == 0.0
    assert seen[9].yaw_rad > 0.2
    assert all(-1.0001 < each.y_m < 1.0001 for each in seen)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({}, "either that of an `actor` or through `points`"),
        ({"actor": "a", "points": [{"time_s": 1.0, "ahead_m": 1.0}]}, "either that of an `actor` or through `points`"),
        ({"points": [{"time_s": 2.0, "ahead_m": 1.0}, {"time_s": 1.0, "ahead_m": 2.0}]}, "in the order of their times"),
    ],
)
def test_a_track_that_is_none_is_refused(fields, words):
    with pytest.raises(msgspec.ValidationError, match=words):
        settings(kind="track", **fields)


def test_the_track_of_an_actor_whatever_place_the_scenario_states():
    times = np.array([0.0, 4.0])
    track = PoseTrack(
        times, np.array([[5.0, 3, 0], [25.0, 3, 0]]), np.tile([1.0, 0, 0, 0], (2, 1)), np.array([True, False])
    )
    actor = Actor("van", "car", (4, 2, 2), patch((0, 0, 0), np.eye(3)[0], np.eye(3)[1], 3, (1, 0, 0)), track)
    scene = replace(small_scene(), actors=(actor,))
    seen = moves(settings(kind="track", actor="van"), car(0), 5.0, scene=scene)
    assert (seen[0].id, seen[0].x_m, seen[0].y_m) == ("car", 5.0, 3.0)
    assert seen[8].x_m == pytest.approx(15.0)
    assert seen[8].speed_m_s == pytest.approx(5.0)
    assert seen[-1] is None
    slow = moves(settings(kind="track", actor="van", pace=0.5), car(0), 5.0, scene=scene)
    assert [each.x_m for each in slow[::2]] == pytest.approx([each.x_m for each in seen[: len(slow[::2])]])
    assert slow[4].speed_m_s == pytest.approx(seen[2].speed_m_s / 2)
    with pytest.raises(ValueError, match="track of actor 'bus': scene 'small' has only van"):
        settings(kind="track", actor="bus").begin(scene, 0.0)


def rollout(tmp_path):
    """A drive of three moments, in whose last nobody but the ego vehicle is there."""
    steps = []
    for k in range(4):
        ego = EgoRecord(x_m=2.0 * k, y_m=0.0, z_m=0.0, yaw_rad=0.0, speed_m_s=4.0, steer_rad=0.0, acceleration_m_s2=0.0,
                        steer_rate_rad_s=0.0, yaw_rate_rad_s=0.0)  # fmt: skip
        yaw = 3.1 if k == 0 else -3.1
        user = UserRecord(id="van", x_m=30.0 - 3 * k, y_m=3.0, z_m=0.0, yaw_rad=yaw, speed_m_s=6.0)
        steps.append(RolloutStep(step=k, time_s=0.5 * k, ego=ego, road_users=(user,) if k < 3 else (), route_left_m=0.0,
                                 route_completion=0.0))  # fmt: skip
    path = tmp_path / "drive.jsonl"
    users = {"van": UserModel(class_name="car", size_lwh_m=(4, 2, 2))}
    drive = Rollout(scenario={}, scene="small", agent="none", seed=0, step_s=0.5, spacing_s=0.5, users=users,
                    end="time", steps=tuple(steps))  # fmt: skip
    write_rollout(path, drive)
    return path


def test_a_replay_is_where_the_drive_had_it(tmp_path):
    seen = moves(settings(kind="replay", rollout=str(rollout(tmp_path)), user="van"), car(0), 2.0)
    assert [each and each.x_m for each in seen] == pytest.approx([30.0, 28.5, 27.0, 25.5, 24.0, None, None, None, None])
    assert seen[1].yaw_rad == pytest.approx(np.pi)  # between 3.1 and -3.1 the short way
    assert seen[1].id == "car"


def test_a_replay_of_the_ego_vehicle_is_of_its_middle(tmp_path):
    seen = moves(settings(kind="replay", rollout=str(rollout(tmp_path)), user="ego"), car(0), 2.5)
    assert seen[2].x_m == pytest.approx(2.0 + 1.3)
    assert (seen[-1].x_m, seen[-1].speed_m_s) == (pytest.approx(6.0 + 1.3), 0.0)


def test_a_replay_of_nothing_says_so(tmp_path):
    scene = small_scene()
    with pytest.raises(ValueError, match="no such roll-out"):
        settings(kind="replay", rollout="nowhere.jsonl", user="van").begin(scene, 0.0)
    with pytest.raises(ValueError, match="nobody is called 'bus' in this roll-out"):
        settings(kind="replay", rollout=str(rollout(tmp_path)), user="bus").begin(scene, 0.0)


def test_an_unknown_kind_is_refused_by_name():
    with pytest.raises(msgspec.ValidationError, match=r"Invalid value 'fly' - at `\$.kind`"):
        msgspec.convert({"kind": "fly"}, BehaviorSettings)
