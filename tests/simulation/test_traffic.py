"""Everybody else on the road: put in place, moved on together, and shown where they are."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.simulation.ground import recorded_route, road_surface_of
from gsrain_engine.simulation.scenario import Traffic
from gsrain_engine.simulation.simulation import RoadScene
from gsrain_engine.simulation.traffic.base import RoadUser
from gsrain_engine.simulation.traffic.tracks import RecordedTrack
from simulation.small_drive import box_actor, in_other_units, lead, scenario, scene_with_box
from small_scene import small_scene

EGO = RoadUser("ego", "car", (4.6, 1.85, 1.5), 1.3, 0.0, 0.0, 4.0)


def traffic(scene, **fields):
    return Traffic(scenario(**fields), scene, recorded_route(scene), road_surface_of(scene))


def test_places_are_measured_from_the_ego_vehicle_s_middle_along_the_route():
    user = traffic(scene_with_box(), road_users=[lead(ahead_m=6.0, left_m=-2.0, turned_deg=90.0)]).users[0]
    assert (user.x_m, user.y_m) == (pytest.approx(1.3 + 6.0), pytest.approx(-2.0))
    assert user.yaw_rad == pytest.approx(np.pi / 2)
    assert user.size_lwh == (4.0, 2.0, 1.5)
    assert user.z_m == pytest.approx(0.0, abs=0.01)


def test_they_start_where_the_ego_vehicle_is_at_the_start():
    user = traffic(scene_with_box(), start_s=2.0, road_users=[lead(ahead_m=6.0, size_lwh_m=[3, 1, 1])]).users[0]
    assert user.x_m == pytest.approx(4.0 + 1.3 + 6.0)
    assert user.size_lwh == (3.0, 1.0, 1.0)


@pytest.mark.parametrize("other", [False, True])
def test_a_kept_actor_follows_its_track(other):
    scene = in_other_units(scene_with_box()) if other else scene_with_box()
    cars = traffic(scene, keep=["box"], start_s=0.5)
    assert cars.users[0].x_m == pytest.approx(6.0)
    for step in range(8):
        cars.advance(step * 0.25, EGO, 0.25)
        user = cars.users[0]
        assert (user.x_m, user.y_m, user.z_m) == pytest.approx((6.0 + 0.5 * (step + 1), 3.0, 0.0), abs=1e-6)
        assert user.speed_m_s == pytest.approx(2.0)
        assert user.size_lwh == pytest.approx((4.0, 2.0, 1.5))


def test_actors_that_are_not_kept_are_gone_and_hidden_ones_do_not_come_along():
    scene = scene_with_box()
    assert traffic(scene).users == ()
    assert len(traffic(scene, keep="all").users) == 1
    hidden = replace(scene, actors=(replace(scene.actors[0], visible=False),))
    assert traffic(hidden, keep="all").users == ()


def test_a_track_has_its_full_speed_where_it_begins_and_ends():
    scene = scene_with_box()
    track = RecordedTrack(scene, scene.actors[0], 0.0)
    assert [track.at(t).speed_m_s for t in (0.0, 0.02, 2.0, 3.98, 4.0)] == pytest.approx([2.0] * 5)
    assert track.at(5.0).speed_m_s == 0.0


def test_everybody_moves_by_where_the_others_were():
    """Whoever comes first in the list has no advantage: two that follow each other end alike in either order."""
    rows = [
        lead(id="front", ahead_m=20.0, speed_m_s=2.0, behaviour={"kind": "idm"}),
        lead(id="rear", ahead_m=12.0, speed_m_s=6.0, behaviour={"kind": "idm"}),
    ]
    places = []
    for order in (rows, rows[::-1]):
        cars = traffic(scene_with_box(), road_users=order)
        for step in range(10):
            cars.advance(step * 0.25, EGO, 0.25)
        places.append({user.id: (user.x_m, user.speed_m_s) for user in cars.users})
    assert places[0] == places[1]
    assert places[0]["rear"][1] < 6.0


def test_who_comes_and_goes_stays_known():
    actor = box_actor(times=(1.0, 2.0, 3.0), positions=((5, 3, 0), (7, 3, 0), (9, 3, 0)))
    coming = replace(actor, track=replace(actor.track, valid=np.array([True, False, False])))
    cars = traffic(replace(small_scene(), actors=(coming,)), keep="all", start_s=1.0)
    there = [len(cars.users)]
    for step in range(6):
        cars.advance(step * 0.25, EGO, 0.25)
        there.append(len(cars.users))
    assert there == [1, 1, 1, 1, 0, 0, 0]
    assert [user.id for user in cars.everybody] == ["box"]
    cars.reset()
    assert len(cars.users) == 1


@pytest.mark.parametrize("other", [False, True])
def test_the_scene_shows_everybody_where_they_are(other):
    """Boxes of what is drawn, in the world."""
    scene = in_other_units(scene_with_box()) if other else scene_with_box()
    rows = [lead(ahead_m=12.0, left_m=2.0, turned_deg=30.0)]
    cars = traffic(scene, keep=["box"], road_users=rows)
    rig = np.eye(4)
    rig[:3, 3] = 2.0, 0.5, 1.5
    shown = RoadScene(scene, cars.looks).at(rig, cars.users)
    np.testing.assert_allclose(shown.ego_to_world(7.0), rig, atol=1e-9)
    for user in cars.users:
        part = shown.part(shown.member(f"actors/{user.id}"), 0.0)
        points = part.gaussians.means @ part.to_world[:3, :3].T + part.to_world[:3, 3]
        local = (points - (user.x_m, user.y_m, user.z_m)) @ user.pose[:3, :3]
        np.testing.assert_allclose(local.min(axis=0), (-2, -1, 0), atol=1e-4)
        np.testing.assert_allclose(local.max(axis=0), (2, 1, 1.5), atol=1e-4)
        size = np.array(shown.member(f"actors/{user.id}").size_lwh) * scene.metres_per_unit
        np.testing.assert_allclose(size, user.size_lwh)
    assert shown.layers == scene.layers
