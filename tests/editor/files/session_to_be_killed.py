"""A editor in a process of its own: opens a scene, changes it, lets the autosave come, and waits to be killed.

Run as a program with a scene folder.
"""

import sys
from concurrent.futures import wait

import numpy as np

from gsrain_engine.editor.drawing.frame import DrawResult
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.members import replace_scene
from gsrain_engine.scene.flags import BitMask, SelectionFlags


def settle(editor: Editor) -> None:
    """Let background work end and take it in, without a live view."""
    for _ in range(4):
        wait(editor.pending_files, timeout=60)
        editor.tick(0.0)
        editor.apply(DrawResult(is_pending_ready=True))


def main(folder: str) -> None:
    """Do as the module says."""
    editor = Editor()
    editor.files.open(folder)
    settle(editor)
    member = editor.document.scene.members[0]
    marks = SelectionFlags(deleted=BitMask.of(np.arange(len(member.gaussians)) < 100))
    editor.document.edit("Delete", replace_scene, editor.document.scene.with_member(member.key, marks=marks))
    editor.document.change_rain("Intensity", intensity_mm_h=8.5)
    editor.tick(0.0)
    late = editor.files.recovery.now() + 20.0
    editor.files.recovery.now = lambda: late
    settle(editor)
    print("kept", flush=True)
    sys.stdin.read()


if __name__ == "__main__":
    main(sys.argv[1])
