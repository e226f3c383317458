"""Selection commands, sets and modes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.editor.editor import Editor
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

N = 50
PUT_TOGETHER = {
    "set": lambda now, found: found,
    "add": lambda now, found: now | found,
    "remove": lambda now, found: now & ~found,
    "intersect": lambda now, found: now & found,
}
flags = st.lists(st.booleans(), min_size=N, max_size=N).map(np.array)


def marked(key="layers/plain", **marks):
    return cloud(N).with_member(key, marks=SelectionFlags(**{name: BitMask.of(each) for name, each in marks.items()}))


@settings(max_examples=30)
@given(flags, flags, flags, flags, st.sampled_from(list(PUT_TOGETHER)))
def test_modes_among_what_is_shown(now, found, hidden, deleted, mode):
    scene = marked(selected=now, hidden=hidden, deleted=deleted)
    after = combine_selection(scene, {"layers/plain": BitMask.of(found)}, mode)
    shown_and_found = found & ~hidden & ~deleted
    assert np.array_equal(selected(after.member("layers/plain")).flags, PUT_TOGETHER[mode](now, shown_and_found))
    assert after.member("layers/plain").marks.hidden is scene.member("layers/plain").marks.hidden


@pytest.mark.parametrize("fields", [{"locked": True}, {"visible": False}])
def test_locked_and_hidden_members_are_passed_by(fields):
    half = np.arange(N) < N // 2
    scene = marked(selected=half).with_member("layers/plain", **fields)
    assert selected_count(scene) == 0
    assert selectable_count(scene) == N
    for after in (all_selected(scene), none_selected(all_selected(scene)), inverted(scene)):
        assert after.member("layers/plain") is scene.member("layers/plain")
    assert selected_count(all_selected(scene)) == N


def test_all_none_invert():
    deleted = np.arange(N) < 10
    scene = marked(deleted=deleted)
    everything = all_selected(scene)
    assert selected_count(everything) == 2 * N - 10 == selectable_count(scene)
    assert not (selected(everything.layers[0]).flags & deleted).any()
    assert selected_count(inverted(everything)) == 0
    assert none_selected(everything).layers[0].marks.selected is None
    half = combine_selection(scene, {"layers/plain": BitMask.of(np.arange(N) % 2 == 0)}, "set")
    assert selected_count(inverted(half)) == selectable_count(scene) - selected_count(half)
    twice = inverted(inverted(half))
    assert all(selected(a).same_as(selected(b)) for a, b in zip(twice.layers, half.layers, strict=True))


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
