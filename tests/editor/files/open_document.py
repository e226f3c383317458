"""Edits of an open document, a job that runs meanwhile, and waiting for their result."""

from concurrent.futures import wait

import numpy as np

from gsrain_engine.editor.jobs.job import Job
from gsrain_engine.editor.viewport_state import PendingScene
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.progress import Progress


def settle(session):
    """Let background work end and take it in, without a live view."""
    for _ in range(4):
        wait(session.pending_files, timeout=60)
        session.update(0.0)
        session.swap_in()


def answer(session, label):
    session.questions.answer(next(each for each in session.questions.present.answers if each.label == label))
    settle(session)


def delete_every_third(session):
    member = session.scene.members[0]
    deleted = BitMask.of(np.arange(len(member.gaussians)) % 3 == 0)
    session.set_scene("Delete", session.scene.with_member(member.key, marks=SelectionFlags(deleted=deleted)))
    return deleted


def keep_now(session):
    """Let the time of an autosave come."""
    session.update(0.0)  # sees the change
    late = session.files.recovery.now() + session.preferences.autosave_s
    session.files.recovery.now = lambda: late
    settle(session)


def names_in(folder):
    return {file.name: file.stat().st_ino for file in folder.rglob("*") if file.is_file()}


class HeldJob(Job):
    """A job that goes on until the test ends it."""

    def __init__(self, session, title="Make it rainy", ends_with_scene=True):
        self.session, self.kind = session, "make rainy"
        self.title, self.ends_with_scene, self.state = title, ends_with_scene, "running"
        self.progress, self.error, self.details = Progress(0.4, "at it"), None, None
        self.result = None
        self.fails = False

    def start(self, files):
        pass

    def poll(self):
        if self.fails:
            self.state, self.error = "failed", "the third wheel is missing"
        elif self.result is not None:
            self.session.staged = PendingScene(self.title, self.result)
            self.state = "finished"

    def cancel(self):
        self.state = "cancelled"
