"""A roll-out as tracks of the scene that the window shows."""

from dataclasses import replace

import pytest

from gsrain_engine.editor.drive import EGO_CAR, RolloutInScene

from .driven import driven


def world_pose(scene, key, time_s):
    member = scene.member(key)
    return scene.scene_to_world @ member.pose_at(time_s)


@pytest.mark.parametrize(("start_s", "scale"), [(0.0, 1.0), (0.7, 0.25)])
def test_everybody_is_where_the_rollout_says_between_its_steps_too(start_s, scale):
    scene, rollout = driven(start_s=start_s, scale=scale)
    shown = RolloutInScene(rollout, scene)
    played = shown.scene(scene, with_ego=True)
    first, second = rollout.steps[2], rollout.steps[3]
    for part in (0.0, 0.3):
        time_s = start_s + (1 - part) * first.time_s + part * second.time_s
        x = (1 - part) * first.ego.x_m + part * second.ego.x_m
        rig = played.ego_to_world(time_s)
        assert rig[:3, 3] == pytest.approx((x, first.ego.y_m, 1.5), abs=0.01)
        body = world_pose(played, f"actors/{EGO_CAR}", time_s)
        assert body[:3, 3] == pytest.approx((x + shown.scenario.vehicle.middle_m, first.ego.y_m, 0.0), abs=0.01)
        lead = first.road_users[0]
        assert world_pose(played, "actors/lead", time_s)[:3, 3] == pytest.approx((lead.x_m, lead.y_m, lead.z_m))


def test_the_same_scene_gives_the_same_value_and_no_gaussians_are_copied():
    scene, rollout = driven()
    shown = RolloutInScene(rollout, scene)
    with_ego, without = shown.scene(scene, with_ego=True), shown.scene(scene, with_ego=False)
    assert shown.scene(scene, with_ego=True) is with_ego
    assert shown.scene(scene, with_ego=False) is without
    assert [each.id for each in without.actors] == ["lead"]
    assert all(a is b for a, b in zip(with_ego.layers, scene.layers, strict=True))
    edited = scene.with_member("layers/wall", visible=False)
    assert shown.fits(edited)
    assert shown.scene(edited, with_ego=True).actors[0].gaussians is with_ego.actors[0].gaussians
    assert not shown.fits(replace(scene, metres_per_unit=2.0))
    stranger = replace(without.actors[0], id="stranger")
    assert shown.fits(replace(scene, actors=(stranger,)))
    assert not shown.fits(replace(scene, actors=without.actors))  # it has an actor of its own called lead
