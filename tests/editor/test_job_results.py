"""Scenes of jobs as undo steps, handed over as a runner does."""

from dataclasses import replace

from gsrain_engine.editor.background_edits import reconstruct
from gsrain_engine.editor.document import Recipe
from gsrain_engine.editor.drawing.frame import DrawResult
from gsrain_engine.editor.job_results import scene_results
from small_scene import small_scene

RECIPE = Recipe(reconstruct, {})


def taking(editor):
    """A receiver of scenes with a number of layers, and the call that brings what is staged into the picture."""
    take, scene = scene_results(editor.viewport, "Grow", RECIPE, is_whole=True), small_scene("grown")
    return (
        lambda layers, is_final=False: take(replace(scene, layers=scene.layers[:layers]), is_final),
        lambda: editor.apply(DrawResult(editor.render_input(96, 64), is_pending_ready=True)),
    )


def test_snapshots_and_result_are_one_step_that_is_undone_at_once(editor):
    before, (take, swap_in) = editor.document.scene, taking(editor)
    for layers, is_final in ((1, False), (2, False), (3, True)):
        take(layers, is_final)
        swap_in()
        assert len(editor.document.scene.layers) == layers
        assert editor.document.history.labels == ["Opened", "Grow"]
    editor.document.undo()
    assert editor.document.scene is before
    editor.document.redo()
    assert len(editor.document.scene.layers) == 3


def test_a_snapshot_waits_for_the_one_before_but_the_result_replaces_it(editor):
    take, _ = taking(editor)
    for layers, is_final, staged in ((1, False, 1), (2, False, 1), (3, True, 3)):
        take(layers, is_final)
        assert len(editor.viewport.staged.scene.layers) == staged


def test_a_result_is_a_step_of_its_own_after_another_edit(editor):
    take, swap_in = taking(editor)
    take(1)
    swap_in()
    editor.document.undo()
    editor.document.change_rain("Intensity", intensity_mm_h=5.0)
    take(2)
    swap_in()
    assert editor.document.history.labels == ["Opened", "Intensity"]
    take(3, is_final=True)
    swap_in()
    assert editor.document.history.labels == ["Opened", "Intensity", "Grow"]
    assert (len(editor.document.scene.layers), editor.document.rain.intensity_mm_h) == (3, 5)


def test_a_scene_that_is_being_opened_is_not_replaced(editor):
    before, (take, swap_in) = editor.document.scene, taking(editor)
    editor.files.open("street")
    take(3, is_final=True)
    swap_in()
    assert editor.document.scene is before and editor.viewport.is_opening
