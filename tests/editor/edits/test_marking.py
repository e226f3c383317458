from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.edits.gaussians import (
    CropBox,
    compact,
    crop,
    delete_selected,
    deleted_count,
    hide_selected,
    isolate_selected,
    selected_count,
    show_all,
)
from gsrain_engine.scene.flags import BitMask

from .edited_scene import assert_same, edited_scene, seen, with_selection


def test_deleting_only_marks():
    scene = with_selection(edited_scene(), ground=5, car=3)
    gone = delete_selected(scene)
    assert gone.gaussian_count == scene.gaussian_count - 8
    assert (selected_count(scene), selected_count(gone), deleted_count(gone)) == (8, 0, 8)
    assert all(a.gaussians is b.gaussians for a, b in zip(gone.members, scene.members, strict=True))
    assert gone.layers[1] is scene.layers[1]
    assert delete_selected(gone) is gone


def test_hidden_ones_come_back_and_deleted_ones_do_not():
    scene = hide_selected(with_selection(edited_scene(), ground=5))
    scene = delete_selected(with_selection(scene, house=4))
    assert len(seen(scene)) == 115 - 9
    shown = show_all(scene)
    assert len(seen(shown)) == 115 - 4
    assert show_all(shown) is shown


def test_isolating_hides_the_rest():
    scene = isolate_selected(with_selection(edited_scene(), ground=5).with_member("layers/sky", locked=True))
    assert len(seen(scene)) == 5 + 20
    assert selected_count(scene) == 5
    with pytest.raises(ValueError, match="Nothing is selected"):
        isolate_selected(edited_scene())


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
