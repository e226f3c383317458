"""Edits of layers: duplicate, separate, merge, rename, import; with their wet colors."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.edits import gaussians, layers, members
from gsrain_engine.editor.edits.actors import turn_actor
from gsrain_engine.editor.edits.gaussians import compact
from gsrain_engine.editor.edits.transform import Pose, move_member, move_selected, preview_move, set_layer_pose
from gsrain_engine.recolor.result import with_colors
from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import ColorGrading
from gsrain_engine.scene.transforms import blend_wet_sh, flatten_scene, with_wet_colors_of, with_wetness_baked

from .edited_scene import assert_same, edited_scene, flattened, turned, with_selection, without


def names(scene):
    return [each.name for each in scene.members]


def test_separating_keeps_the_picture_and_marks_what_left():
    scene = with_selection(edited_scene(), house=7)
    parted = layers.separate(scene)
    assert names(parted) == ["ground", "house", "house 2", "sky", "car"]
    rest, piece = parted.layers[1:3]
    assert (len(piece.gaussians), rest.marks.deleted.size) == (7, 7)
    assert (piece.opacity, piece.grading) == (rest.opacity, rest.grading)
    assert rest.gaussians is scene.layers[1].gaussians
    assert not rest.marks.selected
    assert_same(flattened(parted), flattened(scene))


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
    assert_same(flattened(one), flattened(scene))
    (mask,) = one.selections["both"].values()
    expected = scene.part(scene.layers[1]).to_world @ [*scene.layers[1].gaussians.means[2], 1]
    found = whole.gaussians.means[mask.indices] @ one.part(whole).to_world[:3, :3].T + one.part(whole).to_world[:3, 3]
    assert mask.size == 2
    assert np.abs(found - expected[:3]).sum(axis=1).min() < 1e-5


def test_renaming_keeps_names_unique_and_selection_sets_true():
    mask = BitMask.of(np.arange(40) < 3)
    scene = replace(edited_scene(), selections={"three": {"layers/ground": mask}})
    renamed = layers.rename(scene, "layers/ground", " house ")
    assert names(renamed) == ["house 2", "house", "sky", "car"]
    assert renamed.selections["three"] == {"layers/house 2": mask}
    assert names(layers.rename(scene, "layers/ground", "ground")) == names(scene)
    assert names(layers.rename(scene, "actors/car", "ground"))[-1] == "ground"  # layers and actors apart
    assert layers.remove(renamed, "layers/house 2").selections["three"] == {}
    again = layers.duplicate(layers.duplicate(scene, "layers/house"), "layers/house 2")
    assert names(again) == ["ground", "house", "house 2", "house 3", "sky", "car"]
    for swapped in (layers.move_up(scene, "layers/house"), layers.move_down(scene, "layers/ground")):
        assert names(swapped) == ["house", "ground", "sky", "car"]


def test_one_edit_changes_several_layers_and_actors():
    scene, keys = edited_scene(), ("layers/ground", "layers/sky", "actors/car")

    def changed(edited, field):
        before = {each.key: getattr(each, field) for each in scene.members}
        return [each.key for each in edited.members if getattr(each, field) != before.get(each.key)]

    for given in (keys, [*keys, "layers/gone"], ",".join(keys), " , ".join(keys)):
        assert changed(members.set_opacity(scene, given, 0.3), "opacity") == [*keys]
        assert changed(members.set_visible(scene, given, False), "visible") == [*keys]
        assert changed(members.set_locked(scene, given, True), "locked") == [*keys]
    assert names(layers.remove(scene, ["layers/ground", "actors/car"])) == ["house", "sky"]
    twice = layers.duplicate(layers.duplicate(scene, ["layers/house", "layers/ground"]), "layers/sky")
    assert names(twice) == ["ground", "ground 2", "house", "house 2", "sky", "sky 2", "car"]
    comma = layers.rename(scene, "layers/ground", "grass, wet")
    assert changed(members.set_opacity(comma, "layers/grass, wet", 0.3), "opacity") == ["layers/grass, wet"]
    assert members.members_title(scene.members) == "4 layers and actors"
    assert members.members_title(scene.layers) == "3 layers" and members.members_title(scene.actors) == "car"
    for given in ("layers/none", ["layers/none"], "layers/none, layers/no"):
        with pytest.raises(ValueError, match="layers/none"):
            members.set_opacity(scene, given, 0.3)


def test_fields_of_a_grading_are_set_where_others_differ():
    scene, keys = edited_scene(), ["layers/ground", "layers/house"]
    scene = members.set_grading(scene, keys[0], ColorGrading(contrast=2.0))
    scene = members.set_grading(scene, keys[1], ColorGrading(tint=0.5))
    dark = members.set_grading(scene, keys, exposure_ev=-1.0)
    assert dark.member(keys[0]).grading == ColorGrading(contrast=2.0, exposure_ev=-1.0)
    assert dark.member(keys[1]).grading == ColorGrading(tint=0.5, exposure_ev=-1.0)
    plain = members.set_grading(dark, keys, ColorGrading())
    assert {plain.member(each).grading for each in keys} == {ColorGrading()}


@pytest.mark.parametrize(
    ("edit", "arguments", "reason"),
    [
        (layers.separate, (), "selected"),
        (gaussians.isolate_selected, (), "selected"),
        (layers.rename, ("layers/ground", "  "), "empty"),
        (layers.remove, ("layers/none",), "layers/none"),
        (layers.remove, ("layers/house",), "house is locked"),
        (layers.remove, (["layers/ground", "layers/house"],), "house is locked"),
        (layers.merge, (["layers/ground", "layers/house"],), "house is locked"),
        (layers.merge, (["layers/ground", "layers/ground"],), "two"),
        (layers.merge, (["layers/ground", "actors/car"],), "Actors"),
        (layers.merge, (["layers/ground", "layers/sky"],), "sky"),
        (layers.move_up, ("actors/car",), "first"),
        (layers.move_down, ("layers/sky",), "last"),
        (set_layer_pose, ("layers/ground", Pose((0, 0, 0), (0, 0, 0), 0)), "ground"),
    ],
)
def test_impossible_edits_are_refused_with_the_reason(edit, arguments, reason):
    with pytest.raises(ValueError, match=reason):
        edit(edited_scene().with_member("layers/house", locked=True), *arguments)


@pytest.mark.parametrize(("metres_per_unit", "up"), [(2.0, (0.0, 0.0, 1.0)), (0.75, (0.0, -1.0, 0.0))])
def test_imported_scenes_keep_their_place_in_the_world(metres_per_unit, up):
    scene, sets = edited_scene(), {"set": {"layers/ground": BitMask.all(40)}}
    other = replace(edited_scene(), metres_per_unit=metres_per_unit, up=up, selections=sets)
    both = layers.import_scene(scene, other)
    assert names(both) == ["ground", "house", "sky", "ground 2", "house 2", "sky 2", "car", "car 2"]
    alone = replace(both, layers=both.layers[3:], actors=both.actors[1:])
    for time_s in (0.0, 2.5):
        assert_same(flattened(alone, time_s), flattened(other, time_s), 1e-4)
    assert list(both.selections["set"]) == ["layers/ground 2"]
    assert both.actors[1].size_lwh == pytest.approx(np.array([4.0, 2.0, 1.5]) * metres_per_unit / 0.5)
    assert layers.import_scene(replace(scene, layers=(), actors=()), other) is other


TURN = turned(35, 0, 1.3, (0.5, -0.2, 0.1))


def wet_of(member):
    return np.random.default_rng(len(member.gaussians)).normal(0, 0.4, member.gaussians.sh.shape).astype(np.float32)


def wet_scene(*names):
    """The scene of the other tests with wet colors for the members that are named, a selection and what is deleted."""
    scene = with_selection(edited_scene(), ground=9, house=7, car=5)
    for each in scene.members:
        gone = BitMask.of(np.arange(len(each.gaussians)) % 4 == 1)
        wet = wet_of(each) if not names or each.name in names else None
        scene = scene.with_member(each.key, wet_sh=wet, marks=replace(each.marks, deleted=gone))
    return scene


def wet_image(scene, wetness=0.0):
    """All members flattened one after the other, so that their order does not depend on who is drawn first."""
    baked = with_wetness_baked(scene, wetness)
    alone = [replace(scene, layers=(each,), actors=()) for each in baked.layers]
    alone += [replace(scene, layers=(), actors=(each,)) for each in baked.actors]
    return Gaussians.concatenate([flatten_scene(each) for each in alone])


HOUSES = ["layers/house", "layers/house 2"]
EDITS = {
    "delete": gaussians.delete_selected,
    "isolate": gaussians.isolate_selected,
    "compact": compact,
    "separate": layers.separate,
    "merge": lambda scene: layers.merge(scene, ["layers/ground", "layers/house"]),
    "merge alike": lambda scene: layers.merge(layers.duplicate(scene, "layers/house"), HOUSES),
    "duplicate": lambda scene: layers.duplicate(scene, "actors/car"),
    "rename": lambda scene: layers.rename(scene, "layers/house", "shed"),
    "import": lambda scene: layers.import_scene(replace(without(scene, "sky"), up=(0.0, 0.0, 1.0)), scene),
    "move the selection": lambda scene: move_selected(scene, TURN),
    "shift the selection": lambda scene: move_selected(scene, turned(0, by=(1.0, 0.0, 0.0))),
    "move a layer": lambda scene: move_member(scene, "layers/house", TURN),
    "move an actor": lambda scene: move_member(scene, "actors/car", TURN),
    "drag": lambda scene: preview_move(scene, None, TURN),
    "turn an actor": lambda scene: turn_actor(scene, "actors/car", 30.0),
}


@pytest.mark.parametrize("names", [(), ("ground",), ("house", "car")], ids=["all", "one", "some"])
@pytest.mark.parametrize("name", EDITS)
def test_wet_colours_come_along(name, names):
    edit, scene = EDITS[name], wet_scene(*names)
    edited = edit(scene)
    assert_same(wet_image(edited, 1.0), wet_image(edit(with_wetness_baked(scene, 1.0))))
    assert_same(wet_image(edited, 0.0), wet_image(edit(with_wetness_baked(scene, 0.0))))
    assert any(each.wet_sh is not None for each in edited.members)
    assert np.abs(wet_image(edited, 1.0).sh - wet_image(edited, 0.0).sh).max() > 0.1


def test_blends_end_at_the_very_numbers():
    member = wet_scene().layers[0]
    clear, wet = member.gaussians.sh, member.wet_sh
    assert blend_wet_sh(clear, wet, 0.0).tobytes() == clear.tobytes()
    assert blend_wet_sh(clear, wet, 1.0).tobytes() == wet.tobytes()
    np.testing.assert_allclose(blend_wet_sh(clear, wet, 0.25), 0.75 * clear + 0.25 * wet, atol=1e-6)


def test_a_finished_recolouring_leaves_everything_else():
    scene = edited_scene()
    finished = with_colors(scene, {each.key: wet_of(each) for each in scene.members})
    assert all(new.gaussians is old.gaussians for new, old in zip(finished.members, scene.members, strict=True))
    meanwhile = move_selected(with_selection(layers.rename(scene, "layers/sky", "heaven"), house=3), TURN)
    taken = with_wet_colors_of(meanwhile, finished)
    assert [each.wet_sh is not None for each in taken.members] == [True, True, False, True]
    assert all(new.gaussians is old.gaussians for new, old in zip(taken.members, meanwhile.members, strict=True))
    for without_any, wet in ((without(meanwhile, "ground", "house", "car"), finished), (scene, scene)):
        with pytest.raises(ValueError, match="fit none"):
            with_wet_colors_of(without_any, wet)
