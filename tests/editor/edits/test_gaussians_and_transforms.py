"""Edits of the selection, and moves of layers, actors and the selection."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import strategies as st

from gsrain_engine.editor.edits.gaussians import (
    CropBox,
    compact,
    crop,
    delete_selected,
)
from gsrain_engine.editor.edits.transform import (
    Pose,
    layer_pose,
    move_selected,
    pivot,
    preview_move,
    set_layer_pose,
)
from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.transforms import transform_gaussians

from .edited_scene import assert_same, edited_scene, seen, turned, with_selection, without


def test_compacting_keeps_the_picture_and_remaps_marks_and_sets():
    scene = delete_selected(with_selection(edited_scene(), ground=5))
    ground = scene.layers[0]
    marks = replace(ground.marks, selected=BitMask.of(np.arange(40) % 2 == 0), hidden=BitMask.of(np.arange(40) == 9))
    scene = scene.with_member(ground.key, marks=marks)
    scene = replace(
        scene, selections={"odd": {ground.key: BitMask.of(np.arange(40) % 2 == 1), "layers/house": BitMask.all(30)}}
    )
    small = compact(scene)
    assert len(small.layers[0].gaussians) == 35
    assert small.layers[0].marks.deleted is None
    assert small.layers[0].marks.selected.indices.tolist() == list(range(1, 35, 2))
    assert small.layers[0].marks.hidden.indices.tolist() == [4]
    assert small.selections["odd"][ground.key].indices.tolist() == list(range(0, 35, 2))
    assert small.selections["odd"]["layers/house"] is scene.selections["odd"]["layers/house"]
    assert small.layers[1] is scene.layers[1]
    assert_same(seen(small), seen(scene), 1e-6)
    assert compact(small) is small


def test_cropping_deletes_what_lies_outside_of_the_box():
    scene = edited_scene()
    box = CropBox((0.2, 0.5, -0.5), (1.0, 2.5, 2.2), 30.0)
    cut = crop(scene, box)
    for before, after in zip(scene.layers, cut.layers, strict=True):
        to_world = scene.part(before).to_world
        places = before.gaussians.means @ to_world[:3, :3].T + to_world[:3, 3]
        c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
        own = (places - box.center_m) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        outside = (np.abs(own) > np.array(box.size_m) / 2).any(axis=1)
        if before.kind == "sky":
            assert after is before
        else:
            assert 0 < outside.sum() < len(outside)
            assert np.array_equal(after.marks.deleted.flags, outside)
    assert cut.actors == scene.actors
    assert crop(cut, box) is cut
    assert crop(scene.with_member("layers/ground", locked=True), box).layers[0].marks.deleted is None


def test_corners_of_a_box_are_counted_in_bits():
    corners = CropBox((1.0, 2.0, 3.0), (2.0, 4.0, 6.0), 90.0).corners_m
    for i, corner in enumerate(corners):
        x, y, z = (1 if i & bit else -1 for bit in (4, 2, 1))
        assert corner == pytest.approx([1 - 2 * y, 2 + x, 3 + 3 * z])


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("upper", [False, True])
def test_a_face_follows_the_line_of_sight_and_the_opposite_one_stays(axis, upper):
    box, eye = CropBox((1.0, 2.0, 3.0), (2.0, 4.0, 6.0), 30.0), np.array([20.0, -13.0, 9.0])
    outward = (box.face_m(axis, upper) - box.center_m) / (box.size_m[axis] / 2)
    wanted = box.face_m(axis, upper) + 0.7 * outward
    sight = (wanted - eye) / np.linalg.norm(wanted - eye)
    pulled = box.pulled(axis, upper, eye, sight)
    assert pulled.face_m(axis, upper) == pytest.approx(wanted)
    assert pulled.face_m(axis, not upper) == pytest.approx(box.face_m(axis, not upper))
    through = box.face_m(axis, upper) - 100 * outward - eye
    assert box.pulled(axis, upper, eye, through / np.linalg.norm(through)).size_m[axis] == pytest.approx(0.01)


DELTAS = [
    turned(0, by=(1.0, -2.0, 0.5)),
    turned(50, 2, 1.0, (0.3, 0.1, 0.0)),
    turned(-35, 0, 2.0, (1.0, 0.0, 2.0)),
    turned(0, 0, 0.6),
]


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


def test_the_handle_is_in_the_middle_of_what_is_dragged():
    scene = with_selection(edited_scene(), ground=1, car=1)
    ground, car = (scene.part(member, 2.0) for member in (scene.layers[0], scene.actors[0]))
    places = [(part.to_world @ [*part.gaussians.means[0], 1])[:3] for part in (ground, car)]
    assert pivot(scene, None, 2.0) == pytest.approx(np.mean(places, axis=0))
    assert pivot(scene.with_member("actors/car", locked=True), None, 2.0) == pytest.approx(places[0])
    assert pivot(edited_scene(), None) is None
    assert pivot(scene, "actors/car", 2.0) == pytest.approx(car.to_world[:3, 3])
    middle = np.median(ground.gaussians.means, axis=0)
    assert pivot(scene, "layers/ground") == pytest.approx((ground.to_world @ [*middle, 1])[:3])


def test_a_drag_looks_like_the_move_and_shares_all_arrays():
    scene = with_selection(edited_scene(), ground=6, car=5)
    delta = turned(50, 2, 1.2, (0.3, 0.1, 0.0))
    dragged = preview_move(scene, None, delta, 2.0)
    assert_same(seen(dragged, 2.0), seen(move_selected(scene, delta, 2.0), 2.0), 1e-4)
    assert [each.gaussians for each in dragged.layers[3:]] == [scene.layers[0].gaussians, scene.actors[0].gaussians]


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
    assert layer_pose(scene, "actors/car") == layer_pose(scene, "actors/car", 0.0)
    small = set_layer_pose(scene, "actors/car", replace(pose, scale=0.5), 2.0).actors[0]
    assert small.size_lwh == pytest.approx((2.0, 1.0, 0.75))
    assert small.gaussians.scales == pytest.approx(scene.actors[0].gaussians.scales / 2)
