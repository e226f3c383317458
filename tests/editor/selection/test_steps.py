from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.selection import commands
from gsrain_engine.editor.selection.candidates import selected, selected_count
from gsrain_engine.scene.flags import BitMask

from .selection_scenes import cloud

KEY = "layers/plain"


@pytest.fixture
def session():
    opened = Editor(cloud())
    yield opened
    opened.close()


def first(count):
    return {KEY: BitMask.of(np.arange(300) < count)}


def test_names_of_steps_tell_what_happened(session):
    commands.select(session, first(200), "set", "lasso")
    commands.select(session, {KEY: BitMask.of(np.arange(300) >= 150)}, "add", "brush")
    commands.select(session, first(20), "remove", "box")
    commands.select(session, first(100), "intersect", "sphere")
    commands.select(session, {}, "set", "rectangle")
    commands.select_all(session)
    commands.invert(session)
    assert session.history.labels[1:] == [
        "Select 200 by lasso", "Add 100 by brush", "Remove 20 by box", "Keep 80 by sphere", "Select none by rectangle",
        "Select all 600", "Invert selection to 0",
    ]  # fmt: skip
    session.go_to_step(4)
    assert selected_count(session.scene) == 80


def test_what_changes_nothing_is_no_step(session):
    commands.select_none(session)
    commands.select(session, {}, "set", "lasso")
    commands.select(session, first(5), "remove", "lasso")
    commands.grow(session, 1.0)
    commands.shrink(session, 1.0)
    assert session.history.labels == ["Open"]


def test_growing_and_shrinking_are_steps(session):
    commands.select(session, first(10), "set", "lasso")
    commands.grow(session, 2.0)
    grown = selected_count(session.scene)
    assert grown > 10
    assert session.history.undo_label == f"Grow selection by 2 m to {grown}"
    commands.shrink(session, 1.0)
    assert selected_count(session.scene) < grown


def test_sets_are_saved_recalled_renamed_and_deleted_and_all_is_undone(session):
    assert not commands.has_selection(session)
    commands.select(session, first(30), "set", "lasso")
    assert commands.save_set(session)
    assert list(session.scene.selections) == ["selection 1"]
    commands.select_none(session)
    commands.recall_set(session, "selection 1", "add")
    assert session.history.undo_label == "Add 30 by set selection 1"
    assert commands.rename_set(session, "selection 1", " heads ")
    assert list(session.scene.selections) == ["heads"]
    commands.remove_set(session, "heads")
    assert session.scene.selections == {}
    assert selected_count(session.scene) == 30
    while session.history.undo_label is not None:
        session.undo()
    assert session.scene.selections == {}
    assert selected_count(session.scene) == 0


def test_what_is_wrong_with_a_set_is_told_and_nothing_changes(session):
    assert not commands.save_set(session, "a")
    assert "nothing is selected" in session.problem
    commands.select(session, first(3), "set", "lasso")
    assert not commands.save_set(session, "  ")
    assert "name" in session.problem
    assert commands.save_set(session, "a") and commands.save_set(session, "b")
    before = session.scene
    assert not commands.rename_set(session, "a", "b")
    assert "'b' already" in session.problem
    assert session.scene is before


def test_a_renamed_set_keeps_its_place_and_a_saved_one_replaces_its_namesake(session):
    commands.select(session, first(9), "set", "lasso")
    for name in ("a", "b", "c", "a"):
        commands.save_set(session, name)
    assert list(session.scene.selections) == ["a", "b", "c"]
    commands.rename_set(session, "b", "x")
    assert list(session.scene.selections) == ["a", "x", "c"]


def test_sets_pass_by_members_that_are_gone_or_other(session):
    sets = {"old": {KEY: BitMask.all(7), "layers/gone": BitMask.all(300), "layers/turned": BitMask.all(300)}}
    session.set_scene("Add a set", replace(session.scene, selections=sets))
    commands.recall_set(session, "old", "set")
    assert [each.key for each in session.scene.members if each.marks.selected] == ["layers/turned"]


def test_hidden_gaussians_of_a_set_stay_as_they_are(session):
    commands.select(session, first(30), "set", "lasso")
    commands.save_set(session, "a")
    marks = replace(session.scene.layers[0].marks, selected=None, hidden=first(10)[KEY])
    session.set_scene("Hide", session.scene.with_member(KEY, marks=marks))
    commands.recall_set(session, "a", "set")
    assert selected(session.scene.layers[0]).indices.tolist() == list(range(10, 30))
