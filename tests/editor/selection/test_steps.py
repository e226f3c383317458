from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.editor.selection import commands
from gsrain_engine.editor.selection.candidates import selected, selected_count
from gsrain_engine.scene.flags import BitMask

from .selection_scenes import cloud

KEY = "layers/plain"


@pytest.fixture
def editor():
    opened = Editor(cloud())
    yield opened
    opened.close()


def first(count):
    return {KEY: BitMask.of(np.arange(300) < count)}


def test_names_of_steps_tell_what_happened(editor):
    commands.select(editor, first(200), "set", "lasso")
    commands.select(editor, {KEY: BitMask.of(np.arange(300) >= 150)}, "add", "brush")
    commands.select(editor, first(20), "remove", "box")
    commands.select(editor, first(100), "intersect", "sphere")
    commands.select(editor, {}, "set", "rectangle")
    commands.select_all(editor)
    commands.invert(editor)
    assert editor.document.history.labels[1:] == [
        "Select 200 by lasso", "Add 100 by brush", "Remove 20 by box", "Keep 80 by sphere", "Select none by rectangle",
        "Select all 600", "Invert selection to 0",
    ]  # fmt: skip
    editor.document.go_to_step(4)
    assert selected_count(editor.document.scene) == 80


def test_what_changes_nothing_is_no_step(editor):
    commands.select_none(editor)
    commands.select(editor, {}, "set", "lasso")
    commands.select(editor, first(5), "remove", "lasso")
    commands.grow(editor, 1.0)
    commands.shrink(editor, 1.0)
    assert editor.document.history.labels == ["Open"]


def test_growing_and_shrinking_are_steps(editor):
    commands.select(editor, first(10), "set", "lasso")
    commands.grow(editor, 2.0)
    grown = selected_count(editor.document.scene)
    assert grown > 10
    assert editor.document.history.undo_label == f"Grow selection by 2 m to {grown}"
    commands.shrink(editor, 1.0)
    assert selected_count(editor.document.scene) < grown


def test_sets_are_saved_recalled_renamed_and_deleted_and_all_is_undone(editor):
    assert not commands.has_selection(editor)
    commands.select(editor, first(30), "set", "lasso")
    assert commands.save_set(editor)
    assert list(editor.document.scene.selections) == ["selection 1"]
    commands.select_none(editor)
    commands.recall_set(editor, "selection 1", "add")
    assert editor.document.history.undo_label == "Add 30 by set selection 1"
    assert commands.rename_set(editor, "selection 1", " heads ")
    assert list(editor.document.scene.selections) == ["heads"]
    commands.remove_set(editor, "heads")
    assert editor.document.scene.selections == {}
    assert selected_count(editor.document.scene) == 30
    while editor.document.history.undo_label is not None:
        editor.document.undo()
    assert editor.document.scene.selections == {}
    assert selected_count(editor.document.scene) == 0


def test_what_is_wrong_with_a_set_is_told_and_nothing_changes(editor):
    assert not commands.save_set(editor, "a")
    assert "nothing is selected" in editor.status.problem
    commands.select(editor, first(3), "set", "lasso")
    assert not commands.save_set(editor, "  ")
    assert "name" in editor.status.problem
    assert commands.save_set(editor, "a") and commands.save_set(editor, "b")
    before = editor.document.scene
    assert not commands.rename_set(editor, "a", "b")
    assert "'b' already" in editor.status.problem
    assert editor.document.scene is before


def test_a_renamed_set_keeps_its_place_and_a_saved_one_replaces_its_namesake(editor):
    commands.select(editor, first(9), "set", "lasso")
    for name in ("a", "b", "c", "a"):
        commands.save_set(editor, name)
    assert list(editor.document.scene.selections) == ["a", "b", "c"]
    commands.rename_set(editor, "b", "x")
    assert list(editor.document.scene.selections) == ["a", "x", "c"]


def test_sets_pass_by_members_that_are_gone_or_other(editor):
    sets = {"old": {KEY: BitMask.all(7), "layers/gone": BitMask.all(300), "layers/turned": BitMask.all(300)}}
    editor.document.edit("Add a set", replace_scene, replace(editor.document.scene, selections=sets))
    commands.recall_set(editor, "old", "set")
    assert [each.key for each in editor.document.scene.members if each.marks.selected] == ["layers/turned"]


def test_hidden_gaussians_of_a_set_stay_as_they_are(editor):
    commands.select(editor, first(30), "set", "lasso")
    commands.save_set(editor, "a")
    marks = replace(editor.document.scene.layers[0].marks, selected=None, hidden=first(10)[KEY])
    editor.document.edit("Hide", replace_scene, editor.document.scene.with_member(KEY, marks=marks))
    commands.recall_set(editor, "a", "set")
    assert selected(editor.document.scene.layers[0]).indices.tolist() == list(range(10, 30))
