"""Every edit takes wet colors along: seen soaked, an edited scene is the edited scene of its soaked colors alone."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.edits import gaussians, layers
from gsrain_engine.editor.edits.actors import turn_actor
from gsrain_engine.editor.edits.gaussians import compact
from gsrain_engine.editor.edits.transform import move_member, move_selected, preview_move
from gsrain_engine.recolor.result import with_colors
from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.transforms import (
    blend_wet_sh,
    flatten_scene,
    with_wet_colors_of,
    with_wetness_baked,
)

from .edited_scene import assert_same, edited_scene, turned, with_selection, without

TURN = turned(35, 0, 1.3, (0.5, -0.2, 0.1))


def wet_of(member, seed=5):
    return np.random.default_rng(seed).normal(0, 0.4, member.gaussians.sh.shape).astype(np.float32)


def wet_scene(*names):
    """The scene of the other tests with wet colors for the members that are named, a selection and what is deleted."""
    scene = with_selection(edited_scene(), ground=9, house=7, car=5)
    for seed, each in enumerate(scene.members):
        gone = BitMask.of(np.arange(len(each.gaussians)) % 4 == 1)
        wet = wet_of(each, seed) if not names or each.name in names else None
        scene = scene.with_member(each.key, wet_sh=wet, marks=replace(each.marks, deleted=gone))
    return scene


def soaked(scene):
    """Wet colors as the only ones."""
    return with_wetness_baked(scene, 1.0)


def seen(scene, wetness=0.0):
    baked = [
        flatten_scene(replace(scene, layers=(each,), actors=())) for each in with_wetness_baked(scene, wetness).layers
    ]
    baked += [
        flatten_scene(replace(scene, layers=(), actors=(each,))) for each in with_wetness_baked(scene, wetness).actors
    ]
    return Gaussians.concatenate(baked)


EDITS = {
    "nothing": lambda scene: scene,
    "delete": gaussians.delete_selected,
    "isolate": gaussians.isolate_selected,
    "compact": compact,
    "separate": layers.separate,
    "merge": lambda scene: layers.merge(scene, ["layers/ground", "layers/house"]),
    "merge alike": lambda scene: layers.merge(
        layers.duplicate(scene, "layers/house"), ["layers/house", "layers/house 2"]
    ),
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
    assert_same(seen(edited, 1.0), seen(edit(soaked(scene))))
    assert_same(seen(edited, 0.0), seen(edit(with_wetness_baked(scene, 0.0))))
    assert any(each.wet_sh is not None for each in edited.members)
    assert np.abs(seen(edited, 1.0).sh - seen(edited, 0.0).sh).max() > 0.1


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
    with pytest.raises(ValueError, match="fit none"):
        with_wet_colors_of(without(meanwhile, "ground", "house", "car"), finished)
    with pytest.raises(ValueError, match="fit none"):
        with_wet_colors_of(scene, scene)


def test_colours_of_what_files_know_leave_the_deleted_alone():
    scene = wet_scene()
    house = scene.layers[1]
    kept = (~house.marks.deleted).indices
    sh = wet_of(house)[kept]
    wet = with_colors(scene, {house.key: sh}).layers[1].wet_sh
    np.testing.assert_array_equal(wet[kept], sh)
    np.testing.assert_array_equal(wet[house.marks.deleted.indices], house.gaussians.sh[house.marks.deleted.indices])
