from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.editor.selection.candidates import selected_count
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


def choose(editor, mode, by, found):
    editor.selection.select(mode, by, lambda scene: found)


def test_names_of_steps_tell_what_happened(editor):
    choose(editor, "set", "lasso", first(200))
    choose(editor, "add", "brush", {KEY: BitMask.of(np.arange(300) >= 150)})
    choose(editor, "remove", "box", first(20))
    choose(editor, "intersect", "sphere", first(100))
    choose(editor, "set", "rectangle", {})
    editor.selection.select_all()
    editor.selection.invert()
    assert editor.document.history.labels[1:] == [
        "Select 200 by lasso", "Add 100 by brush", "Remove 20 by box", "Keep 80 by sphere", "Select none by rectangle",
        "Select all 600", "Invert selection to 0",
    ]  # fmt: skip
    editor.document.go_to_step(4)
    assert selected_count(editor.document.scene) == 80


def test_sets_are_saved_recalled_renamed_and_deleted_and_all_is_undone(editor):
    assert editor.selection.is_empty
    choose(editor, "set", "lasso", first(30))
    assert editor.selection.save_set()
    assert list(editor.document.scene.selections) == ["selection 1"]
    editor.selection.select_none()
    editor.selection.recall_set("selection 1", "add")
    assert editor.document.history.undo_label == "Add 30 by set selection 1"
    editor.selection.rename_set("selection 1", " heads ")
    assert list(editor.document.scene.selections) == ["heads"]
    editor.selection.remove_set("heads")
    assert editor.document.scene.selections == {}
    assert selected_count(editor.document.scene) == 30
    while editor.document.history.undo_label is not None:
        editor.document.undo()
    assert editor.document.scene.selections == {}
    assert selected_count(editor.document.scene) == 0


def test_sets_need_a_selection_and_a_name_of_their_own(editor):
    editor.selection.save_set()
    assert "nothing is selected" in editor.status.problem
    choose(editor, "set", "lasso", first(3))
    for editor.selection.set_name in ("a", "b"):
        assert editor.selection.save_set()
    before = editor.document.scene
    for other in ("b", "  "):
        editor.status.dismiss()
        editor.selection.rename_set("a", other)
        assert editor.status.problem and editor.document.scene is before


def test_sets_pass_by_members_that_are_gone_or_other(editor):
    sets = {"old": {KEY: BitMask.all(7), "layers/gone": BitMask.all(300), "layers/turned": BitMask.all(300)}}
    editor.document.edit("Add a set", replace_scene, replace(editor.document.scene, selections=sets))
    editor.selection.recall_set("old", "set")
    assert [each.key for each in editor.document.scene.members if each.marks.selected] == ["layers/turned"]
