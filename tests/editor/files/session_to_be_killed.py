"""A session in a process of its own: opens a scene, changes it, lets the autosave come, and waits to be killed.

Run as a program with a scene folder.
"""

import sys
from concurrent.futures import wait

import numpy as np

from gsrain_engine.editor.editor import Editor
from gsrain_engine.scene.flags import BitMask, SelectionFlags


def settle(session: Editor) -> None:
    """Let background work end and take it in, without a live view."""
    for _ in range(4):
        wait(session.pending_files, timeout=60)
        session.update(0.0)
        session.swap_in()


def main(folder: str) -> None:
    """Do as the module says."""
    session = Editor()
    session.open(folder)
    settle(session)
    member = session.scene.members[0]
    marks = SelectionFlags(deleted=BitMask.of(np.arange(len(member.gaussians)) < 100))
    session.set_scene("Delete", session.scene.with_member(member.key, marks=marks))
    session.change_rain("Intensity", intensity_mm_h=8.5)
    session.update(0.0)
    late = session.files.recovery.now() + 20.0
    session.files.recovery.now = lambda: late
    settle(session)
    print("kept", flush=True)
    sys.stdin.read()


if __name__ == "__main__":
    main(sys.argv[1])
