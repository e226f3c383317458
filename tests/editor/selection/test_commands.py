"""Selection commands, sets and modes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.editor.selection.candidates import (
    all_selected,
    combine_selection,
    inverted,
    none_selected,
    selectable_count,
    selected,
    selected_count,
)
from gsrain_engine.scene.flags import BitMask, SelectionFlags

from .selection_scenes import cloud

N, KEY = 50, "layers/plain"
PUT_TOGETHER = {
    "set": lambda now, found: found,
    "add": lambda now, found: now | found,
    "remove": lambda now, found: now & ~found,
    "intersect": lambda now, found: now & found,
}
flags = st.lists(st.booleans(), min_size=N, max_size=N).map(np.array)


def marked(**marks):
    return cloud(N).with_member(KEY, marks=SelectionFlags(**{name: BitMask.of(each) for name, each in marks.items()}))


@settings(max_examples=30)
@given(flags, flags, flags, flags)
def test_modes_and_whole_selections_among_what_can_be_seen(now, found, hidden, deleted):
    scene, visible = marked(selected=now, hidden=hidden, deleted=deleted), ~hidden & ~deleted
    results = {mode: combine_selection(scene, {KEY: BitMask.of(found)}, mode) for mode in PUT_TOGETHER}
    results |= {"all": all_selected(scene), "none": none_selected(scene), "inverted": inverted(scene)}
    expected = {mode: together(now, found & visible) for mode, together in PUT_TOGETHER.items()}
    expected |= {"all": visible, "none": np.zeros(N, bool), "inverted": visible & ~now}
    for name, after in results.items():
        assert np.array_equal(selected(after.member(KEY)).flags, expected[name])
        assert after.member(KEY).marks.hidden is scene.member(KEY).marks.hidden
    assert selectable_count(scene) == selected_count(all_selected(scene)) == N + visible.sum()


@pytest.mark.parametrize("fields", [{"locked": True}, {"visible": False}])
def test_locked_and_hidden_members_are_passed_by(fields):
    scene = marked(selected=np.arange(N) < N // 2).with_member(KEY, **fields)
    assert (selected_count(scene), selectable_count(scene)) == (0, N)
    for after in (all_selected(scene), none_selected(all_selected(scene)), inverted(scene)):
        assert after.member(KEY) is scene.member(KEY)
    assert selected_count(all_selected(scene)) == N


@pytest.fixture
def selection(editor):
    """The commands of an editor, with the first 30 Gaussians of the road selected."""
    road = BitMask.of(np.arange(len(editor.document.scene.layers[0].gaussians)) < 30)
    editor.selection.select("set", "lasso", lambda _: {"layers/road": road})
    return editor.selection


def test_sets_are_saved_recalled_renamed_and_deleted_and_all_is_undone(editor, selection):
    assert selection.save_set()
    assert list(editor.document.scene.selections) == ["selection 1"]
    selection.select_none()
    assert selection.is_empty
    selection.recall_set("selection 1", "add")
    assert editor.document.history.undo_label == "Add 30 by set selection 1"
    selection.rename_set("selection 1", " heads ")
    assert list(editor.document.scene.selections) == ["heads"]
    selection.remove_set("heads")
    assert (editor.document.scene.selections, selected_count(editor.document.scene)) == ({}, 30)
    while editor.document.history.undo_label is not None:
        editor.document.undo()
    assert (editor.document.scene.selections, selected_count(editor.document.scene)) == ({}, 0)


def test_sets_need_a_selection_and_a_name_of_their_own(editor, selection):
    for selection.set_name in ("a", "b"):
        assert selection.save_set()
    before = editor.document.scene
    for other in ("b", "  "):
        editor.status.dismiss()
        selection.rename_set("a", other)
        assert editor.status.problem and editor.document.scene is before
    selection.select_none()
    assert not selection.save_set() and "nothing is selected" in editor.status.problem
