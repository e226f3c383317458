"""Road users: the IDM and maneuvers against hand-worked numbers, tracks and replays, and everybody together."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.ground import recorded_route, road_surface_of
from gsrain_engine.simulation.rollout_io import write_rollout
from gsrain_engine.simulation.scenario import Traffic
from gsrain_engine.simulation.simulation import RoadScene
from gsrain_engine.simulation.traffic import base
from gsrain_engine.simulation.traffic.models import begin_behavior
from gsrain_engine.simulation.traffic.settings import BehaviorSettings
from simulation.small_drive import box_actor, in_other_units, lead, scenario, scene_with_box, track
from small_rollout import ego, rollout, step, user
from small_scene import small_scene

STRAIGHT = Route(np.array([[0.0, 0.0], [1000.0, 0.0]]))
NOWHERE = base.RoadUser("ego", "car", (4.0, 2.0, 1.5), -1000.0, 0.0, 0.0, 0.0)


def bend(radius_m):
    """A half circle to the left."""
    angles = np.linspace(0, np.pi, 200)
    return Route(radius_m * np.stack([np.sin(angles), 1 - np.cos(angles)], axis=1))


def car(x, y=0.0, speed=0.0, yaw=0.0, id="car"):
    """A road user 4 m long and 2 m wide."""
    return base.RoadUser(id, "car", (4.0, 2.0, 1.5), float(x), float(y), float(yaw), float(speed))


def settings(**fields):
    """A behavior as a scenario file states it."""
    return msgspec.convert(fields, BehaviorSettings)


def moves(behaviour, me, duration_s, *, ego=NOWHERE, others=(), route=STRAIGHT, dt_s=0.25, scene=None):
    """Move one road user; returns it at each moment, the start first. The ego vehicle and others keep their speeds."""
    rule = begin_behavior(behaviour, scene or Scene("none"), 0.0)
    assert isinstance(rule, base.Behavior)
    now = rule.start(me)
    path = [now]
    for number in range(round(duration_s / dt_s)):
        around = base.TrafficState(number * dt_s, ego, tuple(others), route)
        me = now or me
        now = rule.next(me, around, dt_s)
        ego, others = ego.ahead(ego.speed_m_s * dt_s), tuple(each.ahead(each.speed_m_s * dt_s) for each in others)
        path.append(now)
    return path


# Intelligent Driver Model


@given(st.floats(0, 40), st.floats(0.1, 200), st.floats(-20, 40))
def test_the_idm_is_its_equation(speed, gap, closing):
    """Treiber, Hennecke and Helbing (2000), eq. 2 and 3, with HUGSIM's numbers; braking ends at 8 m/s2."""
    idm = settings(kind="idm", desired_speed_m_s=30.0, least_gap_m=5.0, headway_s=2.0, acceleration_m_s2=2.0,
                   comfortable_braking_m_s2=4.0)  # fmt: skip
    free = 1 - (speed / 30) ** 4
    desired = 5 + max(0.0, 2 * speed + speed * closing / (2 * np.sqrt(8)))
    assert idm.acceleration(speed, None) == pytest.approx(max(2 * free, -8.0))
    assert idm.acceleration(speed, gap, closing) == pytest.approx(max(2 * (free - (desired / gap) ** 2), -8.0))


def test_lanes_are_followed_at_the_equilibrium_gap_against_the_route_and_in_bends():
    """At equal speeds and no acceleration: gap = (s0 + v T) / sqrt(1 - (v / v0)^4)."""
    idm = settings(kind="idm", desired_speed_m_s=15.0)
    last = moves(idm, car(1000, 3.4, 8, np.pi), 90.0, others=[car(970, 3.4, 8, np.pi)], dt_s=0.5)[-1]
    gap = (2.0 + 8.0) / np.sqrt(1 - (8 / 15) ** 4)
    assert (last.x_m, last.y_m) == pytest.approx((970 - 8 * 90 + 4 + gap, 3.4), abs=0.05)
    assert (last.speed_m_s, np.cos(last.yaw_rad)) == pytest.approx((8.0, -1.0), abs=0.01)
    path = moves(settings(kind="idm", desired_speed_m_s=8.0), car(0.0, 3.4, 8.0), 12.0, route=bend(50))
    np.testing.assert_allclose([np.hypot(each.x_m, each.y_m - 50) for each in path], 46.6, atol=0.02)
    assert path[-1].yaw_rad == pytest.approx(96 / 46.6, abs=0.03)


# Maneuvers


@pytest.mark.parametrize(
    ("fields", "start", "end"),
    [
        ({"kind": "constant-velocity"}, (0, 0, 6, 0.3), (36 * np.cos(0.3), 36 * np.sin(0.3), 6.0)),
        ({"kind": "stationary"}, (7, 1, 6), (7.0, 1.0, 0.0)),
        ({"kind": "brake", "after_s": 2.0, "deceleration_m_s2": 6.0}, (0, 0, 10), (20 + 100 / 12, 0.0, 0.0)),
        ({"kind": "brake", "after_s": 0.0, "to_speed_m_s": 8.0}, (0, 0, 5), (30.0, 0.0, 5.0)),  # never speeds up
        ({"kind": "cut-in", "after_s": 0.0, "offset_m": -2.0}, (0, 3.4, 5), (30.0, 1.4, 5.0)),
        # 5 m at 5 m/s, 2 s from 5 to 1 m/s, 3 s at 1 m/s
        ({"kind": "cut-in", "after_s": 1.0, "to_speed_m_s": 1.0, "acceleration_m_s2": 2.0}, (0, 3.4, 5), (14.0, 0, 1)),
        ({"kind": "cut-in", "after_s": 1.0, "speed_delay_s": 1.5, "to_speed_m_s": 0.0, "acceleration_m_s2": 5.0},
         (0, 3.4, 5), (12.5 + 2.5, 0.0, 0.0)),
    ],
)  # fmt: skip
def test_where_a_maneuver_has_led_after_six_seconds(fields, start, end):
    last = moves(settings(**fields), car(*start), 6.0)[-1]
    assert (last.x_m, last.y_m, last.speed_m_s) == pytest.approx(end, abs=1e-9)


@pytest.mark.parametrize(
    ("trigger", "me", "ego", "began_s"),
    [
        ({"after_s": 1.5}, car(20, 3.4, 5), car(0, 0, 9), 1.5),
        # The ego vehicle is 16 m behind, bumper to bumper, and 4 m/s faster: 12 m are reached after 1 s.
        ({"gap_m": 12.0}, car(20, 3.4, 5), car(0, 0, 9), 1.0),
        # Overtaking: 4 m ahead, 4 m/s faster: 10 m after 1.5 s.
        ({"gap_m": 10.0}, car(8, 3.4, 9), car(0, 0, 5), 1.5),
        # 16 m, closing by 4 m/s: 2 s are left after 2 s.
        ({"time_to_collision_s": 2.0}, car(20, 3.4, 5), car(0, 0, 9), 2.0),
        ({"time_to_collision_s": 2.0}, car(20, 3.4, 5), car(0, 0, 4), None),  # slower
        ({"time_to_collision_s": 2.0}, car(0, 3.4, 5), car(6, 0, 9), None),  # passed
    ],
)
def test_triggers(trigger, me, ego, began_s):
    path = moves(settings(kind="cut-in", **trigger), me, 4.0, ego=ego)
    changed = [0.25 * k - 0.25 for k, each in enumerate(path) if each.y_m != me.y_m]
    assert (changed[0] if changed else None) == began_s
    assert path == moves(settings(kind="cut-in", **trigger), me, 4.0, ego=ego)


# Tracks


def test_points_are_met_at_their_times_and_it_stands_after_the_last():
    points = [{"time_s": 1.0, "ahead_m": 5.0}, {"time_s": 3.0, "ahead_m": 9.0, "left_m": 2.0}]
    path = moves(settings(kind="track", points=points), car(10, -1, 5), 5.0)
    for number, place in ((4, (15.0, -1.0)), (12, (19.0, 1.0)), (20, (19.0, 1.0))):
        assert (path[number].x_m, path[number].y_m) == pytest.approx(place)
    assert path[-1].speed_m_s == 0.0 and path[9].yaw_rad > 0.2
    assert all(-1.0001 < each.y_m < 1.0001 for each in path)


def test_the_track_of_an_actor_whatever_place_the_scenario_states():
    path_of_van = replace(track([0.0, 4.0], [(5, 3, 0), (25, 3, 0)]), valid=np.array([True, False]))
    actor = replace(box_actor("van"), track=path_of_van)
    scene = replace(small_scene(), actors=(actor,))
    path, slow = (
        moves(settings(kind="track", actor="van", **pace), car(0), 5.0, scene=scene) for pace in ({}, {"pace": 0.5})
    )
    assert (path[0].id, path[0].x_m, path[0].y_m, path[-1]) == ("car", 5.0, 3.0, None)
    assert (path[8].x_m, path[8].speed_m_s) == pytest.approx((15.0, 5.0))
    assert [each.x_m for each in slow[::2]] == pytest.approx([each.x_m for each in path[: len(slow[::2])]])
    assert slow[4].speed_m_s == pytest.approx(path[2].speed_m_s / 2)
    with pytest.raises(ValueError, match="'bus'"):
        begin_behavior(settings(kind="track", actor="bus"), scene, 0.0)


def test_a_replay_is_where_the_drive_had_it(tmp_path):
    drive_file = str(tmp_path / "drive.jsonl")
    users = [[user(30.0 - 3 * k, 3.0, 6.0, -3.1 if k else 3.1, "van")] for k in range(3)]
    steps = [step(k, ego(2.0 * k, speed=4.0), each, step_s=0.5) for k, each in enumerate((*users, ()))]
    write_rollout(drive_file, rollout(steps, step_s=0.5))
    path = moves(settings(kind="replay", rollout=drive_file, user="van"), car(0), 2.0)
    assert [each and each.x_m for each in path] == pytest.approx([30.0, 28.5, 27.0, 25.5, 24.0, None, None, None, None])
    assert path[1].yaw_rad == pytest.approx(np.pi) and path[1].id == "car"  # between 3.1 and -3.1 the shorter turn
    path = moves(settings(kind="replay", rollout=drive_file, user="ego"), car(0), 2.5)
    assert path[2].x_m == pytest.approx(2.0 + 1.0)  # its middle
    assert (path[-1].x_m, path[-1].speed_m_s) == (pytest.approx(6.0 + 1.0), 0.0)
    for file, name, word in (("nowhere.jsonl", "van", "nowhere"), (drive_file, "bus", "'bus'")):
        with pytest.raises(ValueError, match=word):
            begin_behavior(settings(kind="replay", rollout=file, user=name), small_scene(), 0.0)


# Everybody

EGO = base.RoadUser("ego", "car", (4.6, 1.85, 1.5), 1.3, 0.0, 0.0, 4.0)


def traffic(scene, **fields):
    return Traffic(scenario(**fields), scene, recorded_route(scene), road_surface_of(scene))


def advanced(cars, steps):
    """Advance by steps of 0.25 s; yields the road users after each."""
    for number in range(steps):
        cars.advance(number * 0.25, EGO, 0.25)
        yield cars.users


def test_an_actor_that_stays_follows_its_track_and_others_are_gone():
    scene = in_other_units(scene_with_box())
    cars = traffic(scene, keep=["box"], start_s=0.5)
    for number, (there,) in enumerate([cars.users, *advanced(cars, 8)]):
        assert (there.x_m, there.y_m, there.z_m) == pytest.approx((6.0 + 0.5 * number, 3.0, 0.0), abs=1e-6)
        assert (there.speed_m_s, *there.size_lwh) == pytest.approx((2.0, 4.0, 2.0, 1.5))
    assert traffic(scene).users == ()
    going = replace(scene.actors[0], track=replace(scene.actors[0].track, valid=np.array([True, False])))
    cars = traffic(replace(scene, actors=(going,)), keep="all", start_s=1.0)
    assert [len(users) for users in (cars.users, *advanced(cars, 14))] == [1] * 12 + [0] * 3
    assert [each.id for each in cars.everybody] == ["box"]
    cars.reset()
    assert len(cars.users) == 1
    hidden = replace(scene, actors=(replace(scene.actors[0], visible=False),))
    assert traffic(hidden, keep="all").users == ()
    with pytest.raises(ValueError, match="'box'"):
        traffic(scene, keep=["box"], road_users=[lead(id="box")])


def test_everybody_moves_by_where_the_others_were():
    """Two that follow each other end alike in either order of the list."""
    rows = [
        lead(id="front", ahead_m=20.0, speed_m_s=2.0, behaviour={"kind": "idm"}),
        lead(id="rear", ahead_m=12.0, speed_m_s=6.0, behaviour={"kind": "idm"}),
    ]
    one, other = (list(advanced(traffic(scene_with_box(), road_users=order), 10))[-1] for order in (rows, rows[::-1]))
    assert one == other[::-1] and one[1].speed_m_s < 6.0


@pytest.mark.parametrize("other_units", [False, True])
def test_the_scene_shows_everybody_where_they_are(other_units):
    """Boxes of what is drawn, in the world."""
    scene = in_other_units(scene_with_box()) if other_units else scene_with_box()
    cars = traffic(scene, keep=["box"], road_users=[lead(ahead_m=12.0, left_m=2.0, turned_deg=30.0)])
    rig = np.eye(4)
    rig[:3, 3] = 2.0, 0.5, 1.5
    placed = RoadScene(scene, cars.looks).at(rig, cars.users)
    np.testing.assert_allclose(placed.ego_to_world(7.0), rig, atol=1e-9)
    for each in cars.users:
        part = placed.part(placed.member(f"actors/{each.id}"), 0.0)
        points = part.gaussians.means @ part.to_world[:3, :3].T + part.to_world[:3, 3]
        local = (points - (each.x_m, each.y_m, each.z_m)) @ each.pose[:3, :3]
        np.testing.assert_allclose([local.min(axis=0), local.max(axis=0)], [(-2, -1, 0), (2, 1, 1.5)], atol=1e-4)
        size = np.array(placed.member(f"actors/{each.id}").size_lwh) * scene.metres_per_unit
        np.testing.assert_allclose(size, each.size_lwh)
    assert placed.layers == scene.layers
