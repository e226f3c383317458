"""Editors without a window: opened, edited, autosaved."""

import numpy as np

from gsrain_engine.editor.drawing.frame import DrawResult
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.scene.flags import BitMask, SelectionFlags


def settle(editor):
    """Let background work end, and apply its results without a live view."""
    for _ in range(4):
        editor.background.wait(60)
        editor.tick(0.0)
        editor.apply(DrawResult(editor.render_input(96, 64), is_pending_ready=True))


def opened(path):
    editor = Editor()
    editor.files.open(str(path))
    settle(editor)
    assert editor.status.problem is None
    return editor


def answer(editor, label):
    editor.status.answer(next(each for each in editor.status.question.answers if each.label == label))
    settle(editor)


def delete_first(editor, count):
    member = editor.document.scene.members[0]
    marks = SelectionFlags(deleted=BitMask.of(np.arange(len(member.gaussians)) < count))
    editor.document.edit("Delete", replace_scene, editor.document.scene.with_member(member.key, marks=marks))


def deleted_in(scene):
    marked = scene.members[0].marks.deleted if scene.members else None
    return 0 if marked is None else marked.size


def autosave_now(editor):
    """Set the clock to the time of an autosave."""
    editor.tick(0.0)
    late = editor.files.recovery.now() + editor.preferences.value.autosave_s
    editor.files.recovery.now = lambda: late
    settle(editor)
