"""Edits of an open document, a job that runs meanwhile, and waiting for their result."""

import threading

import numpy as np

from gsrain_engine.editor.drawing.frame import DrawResult
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.editor.jobs.job import Job
from gsrain_engine.editor.viewport_state import PendingScene
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.progress import Progress


def settle(editor):
    """Let background work end and take it in, without a live view."""
    for _ in range(4):
        editor.background.wait(60)
        editor.tick(0.0)
        editor.apply(DrawResult(editor.render_input(96, 64), is_pending_ready=True))


def answer(editor, label):
    editor.status.answer(next(each for each in editor.status.question.answers if each.label == label))
    settle(editor)


def delete_every_third(editor):
    member = editor.document.scene.members[0]
    deleted = BitMask.of(np.arange(len(member.gaussians)) % 3 == 0)
    editor.document.edit(
        "Delete", replace_scene, editor.document.scene.with_member(member.key, marks=SelectionFlags(deleted=deleted))
    )
    return deleted


def keep_now(editor):
    """Let the time of an autosave come."""
    editor.tick(0.0)  # sees the change
    late = editor.files.recovery.now() + editor.preferences.value.autosave_s
    editor.files.recovery.now = lambda: late
    settle(editor)


def full_disk(*_, **__):
    raise OSError(28, "No space left on device")


def names_in(folder):
    return {file.name: file.stat().st_ino for file in folder.rglob("*") if file.is_file()}


class HeldJob(Job):
    """A job in a thread that goes on until the test ends it."""

    def __init__(self, title="Make it rainy", **options):
        self._is_ended, self._scene = threading.Event(), None
        super().__init__("make rainy", title, self._held, lambda _: self._scene, in_thread=True, **options)

    def start(self, editor):
        """Start, and wait until it is at work."""

        def stage(scene, _):
            if scene is not None:
                editor.viewport.staged = PendingScene(self.title, scene)

        editor.jobs.start(self, stage)
        while self.progress.fraction < 0.4:
            editor.jobs.wait(0.01)
            editor.jobs.poll()

    def let_end(self, scene=None):
        """End with a scene or without one; for any thread."""
        self._scene = scene
        self._is_ended.set()

    def _held(self):
        while not self._is_ended.wait(0.001):
            yield Progress(0.4, "at it")
