"""Random edits through the editor, then all of them undone and redone: every byte comes back."""

from dataclasses import replace

import msgspec
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits import layers
from gsrain_engine.editor.edits.actors import retime_actor, turn_actor
from gsrain_engine.editor.edits.gaussians import (
    CropBox,
    compact,
    crop,
    delete_selected,
    hide_selected,
    isolate_selected,
    show_all,
)
from gsrain_engine.editor.edits.level import level_from_points, set_length
from gsrain_engine.editor.edits.transform import move_member, move_selected
from gsrain_engine.scene.flags import BitMask
from gsrain_engine.scene.formats.scene_json import record_of
from gsrain_engine.scene.scene import ColorGrading

from .edited_scene import edited_scene, turned


def everything(editor):
    """All bytes of a document."""
    scene = editor.document.scene
    arrays = [
        getattr(member.gaussians, name).tobytes()
        for member in scene.members
        for name in ("means", "scales", "quaternions", "opacities", "sh")
    ]
    masks = [
        None if mask is None else (mask.count, mask.words.tobytes())
        for member in scene.members
        for mask in (member.marks.selected, member.marks.hidden, member.marks.deleted)
    ]
    shown = [(each.key, each.visible, each.locked, each.opacity, each.grading) for each in scene.members]
    places = [each.to_scene.tobytes() for each in scene.layers]
    record = msgspec.json.encode(record_of(scene, [""] * len(scene.members)))
    sets = {
        name: {key: mask.words.tobytes() for key, mask in masks.items()} for name, masks in scene.selections.items()
    }
    return arrays, masks, shown, places, record, sets, editor.document.rain


def select(scene, which, seed):
    member = scene.members[which % len(scene.members)]
    flags = np.random.default_rng(seed).random(len(member.gaussians)) < 0.4
    return scene.with_member(member.key, marks=replace(member.marks, selected=BitMask.of(flags)))


def keep_selection(scene, name):
    masks = {each.key: each.marks.selected for each in scene.members if each.marks.selected is not None}
    return replace(scene, selections=dict(scene.selections) | {name: masks})


def on_member(edit):
    return lambda scene, which, *arguments: edit(scene, scene.members[which % len(scene.members)].key, *arguments)


def on_two(scene, first, second):
    keys = [scene.layers[which % len(scene.layers)].key for which in (first, second)]
    return layers.merge(scene, keys)


WHICH, SEED = st.integers(0, 7), st.integers(0, 99)
DELTA = st.builds(turned, st.floats(-90, 90), st.integers(0, 2), st.floats(0.5, 2),
                  st.tuples(*[st.floats(-3, 3)] * 3))  # fmt: skip
EDIT = st.one_of(
    st.tuples(st.just(select), WHICH, SEED),
    st.tuples(st.sampled_from([delete_selected, hide_selected, show_all, isolate_selected, compact, layers.separate])),
    st.tuples(st.just(keep_selection), st.sampled_from(["a", "b"])),
    st.tuples(st.just(move_selected), DELTA),
    st.tuples(st.just(on_member(move_member)), WHICH, DELTA),
    st.tuples(
        st.just(
            on_member(lambda scene, key, grading, opacity: scene.with_member(key, grading=grading, opacity=opacity))
        ),
        WHICH,
        st.builds(ColorGrading, exposure_ev=st.floats(-2, 2), saturation=st.floats(0, 2)),
        st.floats(0, 1),
    ),
    st.tuples(
        st.just(on_member(lambda scene, key, locked: scene.with_member(key, locked=locked))), WHICH, st.booleans()
    ),
    st.tuples(st.just(on_member(layers.duplicate)), WHICH),
    st.tuples(st.just(on_member(layers.remove)), WHICH),
    st.tuples(st.just(on_member(layers.rename)), WHICH, st.sampled_from(["ground", "house", "", "new"])),
    st.tuples(st.just(on_member(layers.move_up)), WHICH),
    st.tuples(st.just(on_member(layers.move_down)), WHICH),
    st.tuples(st.just(on_two), WHICH, WHICH),
    st.tuples(st.just(on_member(turn_actor)), WHICH, st.floats(-90, 90)),
    st.tuples(st.just(on_member(retime_actor)), WHICH, st.floats(0, 5), st.floats(0.1, 5)),
    st.tuples(st.just(set_length), st.floats(0.5, 2), st.floats(0.5, 2)),
    st.tuples(st.just(level_from_points), st.just(np.array([[0.0, 0, 0], [1, 0, 0.2], [0, 1, 0]]))),
    st.tuples(st.just(crop), st.just(CropBox((0.0, 0.0, 0.0), (3.0, 3.0, 3.0)))),
    st.tuples(st.just("rain"), st.floats(0, 12)),
)


def perform(editor, what, *arguments):
    if what == "rain":
        editor.document.change_rain("Intensity", intensity_mm_h=arguments[0])
    elif editor.document.scene.layers:
        editor.document.edit("Edit", what, *arguments)  # what it refuses leaves the document as it is


@settings(max_examples=40)
@given(st.lists(EDIT, min_size=1, max_size=10))
def test_every_byte_comes_back(edits):
    editor = Editor(edited_scene())
    try:
        states = [everything(editor)]
        for each in edits:
            perform(editor, *each)
            if editor.document.history.cursor == len(states):
                states.append(everything(editor))
        assert editor.document.history.cursor == len(states) - 1
        for state in reversed(states):
            assert everything(editor) == state
            editor.document.undo()
        for state in states:
            assert everything(editor) == state
            editor.document.redo()
    finally:
        editor.close()
