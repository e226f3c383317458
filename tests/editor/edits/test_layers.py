from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.edits import layers
from gsrain_engine.scene.flags import BitMask

from .edited_scene import assert_same, edited_scene, seen, with_selection


def names(scene):
    return [each.name for each in scene.members]


def test_a_duplicate_stands_behind_its_original_and_shares_its_arrays():
    scene = edited_scene()
    twice = layers.duplicate(scene, "layers/ground")
    assert names(twice) == ["ground", "ground 2", "house", "sky", "car"]
    assert twice.layers[1].gaussians is scene.layers[0].gaussians
    assert np.array_equal(twice.layers[1].to_scene, scene.layers[0].to_scene)
    assert names(layers.duplicate(scene, "actors/car"))[-2:] == ["car", "car 2"]
    with pytest.raises(ValueError, match="no 'layers/moon'"):
        layers.duplicate(scene, "layers/moon")


def test_separating_keeps_the_picture_and_marks_what_left():
    scene = with_selection(edited_scene(), house=7)
    parted = layers.separate(scene)
    assert names(parted) == ["ground", "house", "house 2", "sky", "car"]
    rest, piece = parted.layers[1:3]
    assert (len(piece.gaussians), rest.marks.deleted.size) == (7, 7)
    assert (piece.opacity, piece.grading) == (rest.opacity, rest.grading)
    assert rest.gaussians is scene.layers[1].gaussians
    assert not rest.marks.selected
    assert_same(seen(parted), seen(scene))


def test_what_is_selected_of_several_layers_becomes_one():
    scene = with_selection(edited_scene(), ground=5, house=6, car=4, sky=3)
    parted = layers.separate(scene)
    assert names(parted) == ["ground", "ground 2", "house", "sky", "sky 2", "car", "car 2"]
    assert len(parted.layers[1].gaussians) == 11
    assert parted.actors[1].track is scene.actors[0].track
    assert_same(seen(parted), seen(scene))
    with pytest.raises(ValueError, match="Nothing is selected"):
        layers.separate(edited_scene())


def test_merging_keeps_the_picture_and_the_marks():
    scene = with_selection(edited_scene(), ground=5, house=6)
    ground = scene.layers[0]
    marks = replace(ground.marks, deleted=BitMask.of(np.arange(40) >= 30), hidden=BitMask.of(np.arange(40) == 7))
    scene = scene.with_member(ground.key, marks=marks)
    saved = {"both": {ground.key: BitMask.of(np.arange(40) == 3), "layers/house": BitMask.of(np.arange(30) == 2)}}
    scene = replace(scene, selections=saved)
    one = layers.merge(scene, ["layers/ground", "layers/house"])
    assert names(one) == ["ground", "sky", "car"]
    whole = one.layers[0]
    assert len(whole.gaussians) == 60
    assert (whole.marks.selected.size, whole.marks.hidden.size, whole.marks.deleted) == (11, 1, None)
    assert_same(seen(one), seen(scene))
    (mask,) = one.selections["both"].values()
    expected = scene.part(scene.layers[1]).to_world @ [*scene.layers[1].gaussians.means[2], 1]
    found = whole.gaussians.means[mask.indices] @ one.part(whole).to_world[:3, :3].T + one.part(whole).to_world[:3, 3]
    assert mask.size == 2
    assert np.abs(found - expected[:3]).sum(axis=1).min() < 1e-5


@pytest.mark.parametrize(
    ("keys", "trouble"),
    [
        (["layers/ground"], "two layers or more"),
        (["layers/ground", "layers/ground"], "two layers or more"),
        (["layers/ground", "actors/car"], "Actors"),
        (["layers/ground", "layers/sky"], "sky"),
        (["layers/ground", "layers/moon"], "no 'layers/moon'"),
    ],
)
def test_what_can_not_be_merged_is_told(keys, trouble):
    with pytest.raises(ValueError, match=trouble):
        layers.merge(edited_scene(), keys)


def test_renaming_keeps_names_unique_and_selection_sets_true():
    mask = BitMask.of(np.arange(40) < 3)
    scene = replace(edited_scene(), selections={"three": {"layers/ground": mask}})
    renamed = layers.rename(scene, "layers/ground", " house ")
    assert names(renamed) == ["house 2", "house", "sky", "car"]
    assert renamed.selections["three"] == {"layers/house 2": mask}
    assert names(layers.rename(scene, "layers/ground", "ground")) == names(scene)
    assert names(layers.rename(scene, "actors/car", "ground"))[-1] == "ground"  # layers and actors apart
    assert layers.remove(renamed, "layers/house 2").selections["three"] == {}
    with pytest.raises(ValueError, match="empty"):
        layers.rename(scene, "layers/ground", "  ")


def test_order_changes_by_one_place():
    scene = edited_scene()
    assert names(layers.move_down(scene, "layers/ground")) == ["house", "ground", "sky", "car"]
    assert names(layers.move_up(scene, "layers/sky")) == ["ground", "sky", "house", "car"]
    for move, key in (
        (layers.move_up, "layers/ground"),
        (layers.move_down, "layers/sky"),
        (layers.move_up, "actors/car"),
    ):
        with pytest.raises(ValueError, match="already"):
            move(scene, key)


def test_imported_scenes_keep_their_place_in_the_world():
    scene, other = edited_scene(), replace(edited_scene(), metres_per_unit=2.0, up=(0.0, 0.0, 1.0))
    other = replace(other, selections={"set": {"layers/ground": BitMask.all(40)}})
    both = layers.import_scene(scene, other)
    assert names(both) == ["ground", "house", "sky", "ground 2", "house 2", "sky 2", "car", "car 2"]
    alone = replace(both, layers=both.layers[3:], actors=both.actors[1:])
    for time_s in (0.0, 2.5):
        assert_same(seen(alone, time_s), seen(other, time_s), 1e-4)
    assert list(both.selections["set"]) == ["layers/ground 2"]
    assert both.actors[1].size_lwh == pytest.approx((16.0, 8.0, 6.0))  # 2 m instead of 0.5 m a unit
    assert layers.import_scene(replace(scene, layers=(), actors=()), other) is other
