from dataclasses import replace

import numpy as np
import pytest
from hypothesis import strategies as st

from gsrain_engine.editor.edits.actors import duration_of, retime_actor, start_of
from gsrain_engine.editor.edits.transform import (
    Pose,
    layer_pose,
    move_member,
    move_selected,
    preview_move,
    set_layer_pose,
)
from gsrain_engine.scene.transforms import transform_gaussians

from .edited_scene import assert_same, edited_scene, turned, with_selection, without

DELTAS = [turned(0, by=(1.0, -2.0, 0.5)), turned(50, 2, 1.0, (0.3, 0.1, 0.0)), turned(-35, 0, 1.7, (1.0, 0.0, 2.0))]


@pytest.mark.parametrize("delta", DELTAS)
@pytest.mark.parametrize("name", ["ground", "car"])
def test_a_member_is_moved_in_the_world(delta, name):
    scene = without(edited_scene(), *({"ground", "house", "sky", "car"} - {name}))
    key = scene.members[0].key
    for time_s in (0.0, 2.5):
        before, after = scene.parts(time_s)[0], move_member(scene, key, delta).parts(time_s)[0]
        expected = transform_gaussians(transform_gaussians(before.gaussians, before.to_world), delta)
        assert_same(transform_gaussians(after.gaussians, after.to_world), expected)


def test_a_layer_moves_without_new_arrays_and_a_locked_one_not_at_all():
    scene = edited_scene()
    assert move_member(scene, "layers/ground", DELTAS[2]).layers[0].gaussians is scene.layers[0].gaussians
    with pytest.raises(ValueError, match="ground is locked"):
        move_member(scene.with_member("layers/ground", locked=True), "layers/ground", DELTAS[0])


@pytest.mark.parametrize("delta", DELTAS)
def test_what_is_selected_is_moved_and_nothing_else(delta):
    scene = with_selection(edited_scene(), ground=6, car=5)
    there = move_selected(scene, delta, 1.5)
    for member, count in ((scene.layers[0], 6), (scene.actors[0], 5)):
        before, after = scene.part(member, 1.5), there.part(there.member(member.key), 1.5)
        first, rest = slice(0, count), slice(count, None)
        expected = transform_gaussians(transform_gaussians(before.gaussians.take(first), before.to_world), delta)
        assert_same(transform_gaussians(after.gaussians.take(first), after.to_world), expected)
        for name in ("means", "scales", "quaternions", "opacities", "sh"):
            assert np.array_equal(getattr(after.gaussians, name)[rest], getattr(before.gaussians, name)[rest])
    assert there.layers[1] is scene.layers[1]


def test_a_drag_shares_arrays_and_masks_from_frame_to_frame():
    scene = with_selection(edited_scene(), ground=6)
    first, second = (preview_move(scene, None, delta) for delta in DELTAS[:2])
    for one, other in zip(first.layers, second.layers, strict=True):
        assert one.gaussians is other.gaussians
        assert one.marks.left_out is other.marks.left_out
    assert first.layers[-1].gaussians is scene.layers[0].gaussians


ANGLE, METRES = st.floats(-179, 179), st.floats(-50, 50)


def test_a_layer_is_placed_by_numbers():
    scene = without(edited_scene(), "house", "sky", "car").with_member("layers/ground", to_scene=np.eye(4))
    assert layer_pose(scene, "layers/ground") == Pose((0, 0, 0), (0, 0, 0), 1)
    pose = Pose((1.0, -2.0, 3.0), (10.0, 20.0, -30.0), 2.0)
    placed = set_layer_pose(scene, "layers/ground", pose)
    assert placed.part(placed.layers[0]).to_world == pytest.approx(pose.matrix @ scene.part(scene.layers[0]).to_world)
    again = layer_pose(placed, "layers/ground")
    assert (again.position_m, again.turn_deg) == (pytest.approx(pose.position_m), pytest.approx(pose.turn_deg))
    with pytest.raises(ValueError, match="above 0"):
        set_layer_pose(scene, "layers/ground", replace(pose, scale=0.0))


def test_an_actor_is_placed_where_the_numbers_say_at_that_moment():
    scene = replace(edited_scene(), up=(0.0, 0.0, 1.0))
    pose = layer_pose(scene, "actors/car", 2.0)
    assert (pose.position_m, pose.scale) == (pytest.approx((1.0, 0.0, 0.0)), pytest.approx(1))
    placed = set_layer_pose(scene, "actors/car", replace(pose, position_m=(5.0, 6.0, 0.0)), 2.0)
    assert layer_pose(placed, "actors/car", 2.0).position_m == pytest.approx((5.0, 6.0, 0.0))
    assert layer_pose(placed, "actors/car", 0.0).position_m == pytest.approx((4.0, 6.0, 0.0))
    assert placed.actors[0].gaussians is scene.actors[0].gaussians


def test_an_actor_drives_at_other_times():
    later = retime_actor(edited_scene(), "actors/car", 10.0, 2.0).actors[0]
    assert (start_of(later), duration_of(later)) == (10.0, 2.0)
    assert later.pose_at(11.0)[:3, 3] == pytest.approx([2.0, 0, 0])  # half way
    with pytest.raises(ValueError, match="longer than 0 s"):
        retime_actor(edited_scene(), "actors/car", 0.0, 0.0)
