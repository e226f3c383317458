"""What a person does with an open document, and waiting for what comes of it."""

from concurrent.futures import wait

import numpy as np

from gsrain_engine.scene.marks import Marks
from gsrain_engine.scene.mask import Mask


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
    deleted = Mask.of(np.arange(len(member.gaussians)) % 3 == 0)
    session.set_scene("Delete", session.scene.with_member(member.key, marks=Marks(deleted=deleted)))
    return deleted


def keep_now(session):
    """Let the time of an autosave come."""
    session.update(0.0)  # sees the change
    late = session.files.recovery.now() + session.preferences.autosave_s
    session.files.recovery.now = lambda: late
    settle(session)


def names_in(folder):
    return {file.name: file.stat().st_ino for file in folder.rglob("*") if file.is_file()}
