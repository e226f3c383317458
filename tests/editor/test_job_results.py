"""Scenes of jobs as undo steps, handed over as a runner does."""

from dataclasses import replace

import pytest

from gsrain_engine.editor.background_edits import reconstruct
from gsrain_engine.editor.document import Recipe
from gsrain_engine.editor.drawing.frame import DrawResult
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import set_visible
from gsrain_engine.editor.job_results import scene_results
from small_scene import small_scene

RECIPE = Recipe(reconstruct, {})


@pytest.fixture
def editor():
    opened = Editor(small_scene())
    yield opened
    opened.close()


def grown(layers):
    scene = small_scene("grown")
    return replace(scene, layers=scene.layers[:layers])


def test_snapshots_and_result_are_one_step_that_is_undone_at_once(editor):
    before, take = editor.document.scene, scene_results(editor.viewport, "Grow", RECIPE, is_whole=True)
    for layers, is_final in ((1, False), (2, False), (3, True)):
        take(grown(layers), is_final)
        editor.apply(DrawResult(is_pending_ready=True))
        assert len(editor.document.scene.layers) == layers
        assert editor.document.history.labels == ["Open", "Grow"]
    editor.document.undo()
    assert editor.document.scene is before
    editor.document.redo()
    assert len(editor.document.scene.layers) == 3


def test_a_snapshot_waits_for_the_one_before_but_the_result_replaces_it(editor):
    take = scene_results(editor.viewport, "Grow", RECIPE, is_whole=True)
    for layers, is_final, staged in ((1, False, 1), (2, False, 1), (3, True, 3)):
        take(grown(layers), is_final)
        assert len(editor.viewport.staged.scene.layers) == staged


def test_a_result_is_a_step_of_its_own_after_another_edit(editor):
    take = scene_results(editor.viewport, "Grow", RECIPE, is_whole=True)
    take(grown(1), False)
    editor.apply(DrawResult(is_pending_ready=True))
    editor.document.undo()
    editor.document.change_rain("Intensity", intensity_mm_h=5.0)
    take(grown(2), False)
    editor.apply(DrawResult(is_pending_ready=True))
    assert editor.document.history.labels == ["Open", "Intensity"]
    take(grown(3), True)
    editor.apply(DrawResult(is_pending_ready=True))
    assert editor.document.history.labels == ["Open", "Intensity", "Grow"]
    assert len(editor.document.scene.layers) == 3
    assert editor.document.rain.intensity_mm_h == 5


def test_wet_colors_are_added_to_the_scene_as_it_is_by_then(editor):
    road = editor.document.scene.member("layers/road")
    colored = editor.document.scene.with_member(road.key, wet_sh=road.gaussians.sh * 0.5)
    editor.document.edit("Show or hide", set_visible, "layers/wall", False)
    scene_results(editor.viewport, "Recolor", RECIPE)(colored, True)
    editor.apply(DrawResult(is_pending_ready=True))
    assert editor.document.scene.member(road.key).wet_sh is colored.member(road.key).wet_sh
    assert not editor.document.scene.member("layers/wall").visible
    assert editor.document.history.undo_label == "Recolor"


def test_a_scene_that_is_being_opened_is_not_replaced(editor, tmp_path):
    before, take = editor.document.scene, scene_results(editor.viewport, "Grow", RECIPE, is_whole=True)
    editor.files.open("street")
    take(grown(3), True)
    editor.apply(DrawResult(is_pending_ready=True))
    assert editor.document.scene is before and editor.viewport.is_opening
