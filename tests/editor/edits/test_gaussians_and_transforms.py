"""Edits of the selection, and moves of layers, actors and the selection."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from gsrain_engine.editor.edits.gaussians import (
    CropBox,
    box_around,
    compact,
    crop,
    delete_selected,
    deleted_count,
    deletions,
    hide_selected,
    isolate_selected,
    selected_count,
    show_all,
)
from gsrain_engine.editor.edits.layers import separate
from gsrain_engine.editor.edits.transform import Pose, layer_pose, move_selected, pivot, preview_move, set_layer_pose
from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Layer, Scene
from gsrain_engine.scene.transforms import transform_gaussians

from .edited_scene import assert_same, edited_scene, flattened, turned, with_selection, without


def test_deletions_are_listed_by_the_step_that_made_them_until_they_are_purged():
    opened = delete_selected(with_selection(edited_scene(), ground=5))
    deleted = delete_selected(with_selection(opened, ground=9))
    separated = separate(with_selection(deleted, house=4))
    steps = [("Opened", opened), ("Delete 4", deleted), ("Hide", deleted), ("Separate", separated)]
    found = deletions(steps)
    assert [label for label, _ in found] == ["Opened", "Delete 4", "Separate"]
    assert sum(count for _, count in found) == deleted_count(separated) and dict(found)["Separate"] == 4
    assert deletions([*steps, ("Purge", compact(separated))]) == []


def test_compacting_keeps_the_picture_and_remaps_marks_and_sets():
    scene = delete_selected(with_selection(edited_scene(), ground=5))
    ground, number = scene.layers[0], np.arange(40)
    marks = replace(ground.marks, selected=BitMask.of(number % 2 == 0), hidden=BitMask.of(number == 9))
    sets = {"odd": {ground.key: BitMask.of(number % 2 == 1), "layers/house": BitMask.all(30)}}
    scene = replace(scene.with_member(ground.key, marks=marks), selections=sets)
    small = compact(scene)
    after = small.layers[0].marks
    assert (len(small.layers[0].gaussians), after.deleted) == (35, None)
    assert after.selected.indices.tolist() == list(range(1, 35, 2))
    assert after.hidden.indices.tolist() == [4]
    assert small.selections["odd"][ground.key].indices.tolist() == list(range(0, 35, 2))
    assert small.selections["odd"]["layers/house"] is sets["odd"]["layers/house"]
    assert small.layers[1] is scene.layers[1]
    assert_same(flattened(small), flattened(scene), 1e-6)
    assert compact(small) is small


def test_the_selection_is_hidden_or_isolated_and_comes_back():
    scene = with_selection(edited_scene(), ground=5)
    hidden, isolated = hide_selected(scene), isolate_selected(scene)
    assert (hidden.layers[0].marks.hidden.indices.tolist(), hidden.layers[0].marks.selected) == ([0, 1, 2, 3, 4], None)
    assert [each.marks.hidden.size for each in isolated.members] == [35, 30, 20, 25]
    for changed in (hidden, isolated):
        assert all(each.marks.hidden is None for each in show_all(changed).members)
    assert [selected_count(each) for each in (scene, hidden, isolated)] == [5, 0, 5]


def test_cropping_deletes_what_lies_outside_of_the_box():
    scene = edited_scene()
    box = CropBox((0.2, 0.5, -0.5), (1.0, 2.5, 2.2), 30.0)
    cut = crop(scene, box)
    for before, after in zip(scene.layers[:2], cut.layers, strict=False):
        to_world = scene.part(before).to_world
        places = before.gaussians.means @ to_world[:3, :3].T + to_world[:3, 3]
        own = (places - box.center_m) @ turned(30)[:3, :3]
        outside = (np.abs(own) > np.array(box.size_m) / 2).any(axis=1)
        assert 0 < outside.sum() < len(outside)
        assert np.array_equal(after.marks.deleted.flags, outside)
    assert (cut.layers[2], cut.actors) == (scene.layers[2], scene.actors)  # sky and car
    assert crop(cut, box) is cut
    assert crop(scene.with_member("layers/ground", locked=True), box).layers[0].marks.deleted is None


def test_corners_of_a_box_are_counted_in_bits():
    for corner, (x, y, z) in zip(
        CropBox((1.0, 2.0, 3.0), (2.0, 4.0, 6.0), 90.0).corners_m, product((-1, 1), repeat=3), strict=True
    ):
        assert corner == pytest.approx([1 - 2 * y, 2 + x, 3 + 3 * z])


@pytest.mark.parametrize(("axis", "upper"), list(product(range(3), (False, True))))
def test_a_face_follows_the_line_of_sight_and_the_opposite_one_stays(axis, upper):
    box, eye = CropBox((1.0, 2.0, 3.0), (2.0, 4.0, 6.0), 30.0), np.array([20.0, -13.0, 9.0])
    outward = (box.face_m(axis, upper) - box.center_m) / (box.size_m[axis] / 2)

    def pulled_to(distance_m):
        sight = box.face_m(axis, upper) + distance_m * outward - eye
        return box.pulled(axis, upper, eye, sight / np.linalg.norm(sight))

    pulled = pulled_to(0.7)
    assert pulled.face_m(axis, upper) == pytest.approx(box.face_m(axis, upper) + 0.7 * outward)
    assert pulled.face_m(axis, not upper) == pytest.approx(box.face_m(axis, not upper))
    assert pulled_to(-100).size_m[axis] == pytest.approx(0.01)
    assert box.pulled(axis, upper, eye, outward) is box  # the axis points at the eye
    assert box_around(Scene("empty")) == CropBox((0.0, 0.0, 0.0), (10.0, 10.0, 10.0))


def test_cropping_to_the_box_around_a_thing_removes_nothing_of_it_but_what_is_far():
    f, rng = np.float32, np.random.default_rng(4)
    inside = rng.normal(size=(5000, 3))
    inside *= rng.random((5000, 1)) ** (1 / 3) / np.linalg.norm(inside, axis=1, keepdims=True)  # a ball of 1 m
    means = np.concatenate([inside, [[6.0, 0, 0], [0, -5, 2]]]).astype(f)
    n = len(means)
    gaussians = Gaussians(
        means, np.full((n, 3), 0.02, f), np.tile(np.array([1, 0, 0, 0], f), (n, 1)), np.full(n, 0.9, f),
        np.zeros((n, 1, 3), f),
    )  # fmt: skip
    scene = Scene("ball", (Layer("ball", gaussians),))
    cropped = crop(scene, box_around(scene)).layers[0].marks.deleted
    assert cropped is not None and cropped.indices.tolist() == [n - 2, n - 1]


DELTAS = [
    turned(0, by=(1.0, -2.0, 0.5)),
    turned(50, 2, 1.0, (0.3, 0.1, 0.0)),
    turned(-35, 0, 2.0, (1.0, 0.0, 2.0)),
    turned(0, 0, 0.6),
]


@pytest.mark.parametrize("delta", DELTAS)
def test_the_selection_is_moved_and_nothing_else_and_a_drag_looks_the_same(delta):
    scene = with_selection(edited_scene(), ground=6, car=5)
    there = move_selected(scene, delta, 1.5)
    for member, count in ((scene.layers[0], 6), (scene.actors[0], 5)):
        before, after = scene.part(member, 1.5), there.part(there.member(member.key), 1.5)
        first = slice(0, count)
        expected = transform_gaussians(transform_gaussians(before.gaussians.take(first), before.to_world), delta)
        assert_same(transform_gaussians(after.gaussians.take(first), after.to_world), expected)
        for name in ("means", "scales", "quaternions", "opacities", "sh"):
            assert np.array_equal(getattr(after.gaussians, name)[count:], getattr(before.gaussians, name)[count:])
    assert there.layers[1] is scene.layers[1]
    dragged = preview_move(scene, None, delta, 1.5)
    assert_same(flattened(dragged, 1.5), flattened(there, 1.5), 1e-4)
    assert [each.gaussians for each in dragged.layers[3:]] == [scene.layers[0].gaussians, scene.actors[0].gaussians]


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


def test_a_layer_is_placed_by_numbers():
    scene = without(edited_scene(), "house", "sky", "car").with_member("layers/ground", to_scene=np.eye(4))
    assert layer_pose(scene, "layers/ground") == Pose((0, 0, 0), (0, 0, 0), 1)
    for turn_deg in ((10.0, 20.0, -30.0), (25.0, 90.0, 0.0)):
        pose = Pose((1.0, -2.0, 3.0), turn_deg, 2.0)
        placed = set_layer_pose(scene, "layers/ground", pose)
        before = scene.part(scene.layers[0]).to_world
        assert placed.part(placed.layers[0]).to_world == pytest.approx(pose.matrix @ before)
        again = layer_pose(placed, "layers/ground")
        assert (again.position_m, again.turn_deg) == (pytest.approx(pose.position_m), pytest.approx(turn_deg))


def test_an_actor_is_placed_where_the_numbers_say_at_that_moment():
    scene = replace(edited_scene(), up=(0.0, 0.0, 1.0))
    pose = layer_pose(scene, "actors/car", 2.0)
    assert (pose.position_m, pose.scale) == (pytest.approx((1.0, 0.0, 0.0)), pytest.approx(1))
    placed = set_layer_pose(scene, "actors/car", replace(pose, position_m=(5.0, 6.0, 0.0)), 2.0)
    assert layer_pose(placed, "actors/car", 2.0).position_m == pytest.approx((5.0, 6.0, 0.0))
    assert layer_pose(placed, "actors/car").position_m == pytest.approx((4.0, 6.0, 0.0))  # at 0 s
    assert placed.actors[0].gaussians is scene.actors[0].gaussians
    absent = scene.with_member("actors/car", track=replace(scene.actors[0].track, valid=np.zeros(5, bool)))
    assert layer_pose(absent, "actors/car", 2.0) is None
    with pytest.raises(ValueError, match="car"):
        set_layer_pose(absent, "actors/car", pose, 2.0)
    small = set_layer_pose(scene, "actors/car", replace(pose, scale=0.5), 2.0).actors[0]
    assert small.size_lwh == pytest.approx((2.0, 1.0, 0.75))
    assert small.gaussians.scales == pytest.approx(scene.actors[0].gaussians.scales / 2)
