"""Kills sessions at random calls that change the disk, while they edit, keep and save, and recovers what they had.

`python tests/reliability/killed_sessions.py [--deaths 40] [--seed 0]`, on a system that can fork. Not a test. A editor
deletes one Gaussian more at each step, and says when that was kept by the autosave or saved. After each death the next
editor has to open the scene, to offer what was kept, and to have at least all steps that were said to be safe.
"""

import argparse
import os
import random
import signal
import sys
import tempfile
from concurrent.futures import wait
from functools import partial
from pathlib import Path

os.environ["NUMBA_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from gsrain_engine.compile_cache import use_kernel_cache  # noqa: E402
from gsrain_engine.editor.drawing.frame import DrawResult  # noqa: E402
from gsrain_engine.editor.edits.members import replace_scene  # noqa: E402

use_kernel_cache()

import numpy as np  # noqa: E402

from gsrain_engine.editor.editor import Editor  # noqa: E402
from gsrain_engine.scene.flags import (  # noqa: E402
    BitMask,
    SelectionFlags,
)
from gsrain_engine.scene.formats.scene_files import write_scene  # noqa: E402
from reliability.dying import run_in_child  # noqa: E402
from small_scene import small_scene  # noqa: E402

_STEPS = 6


def settle(editor: Editor) -> None:
    """Let background work end and take it in, without a live view."""
    for _ in range(4):
        wait(editor.pending_files, timeout=60)
        editor.tick(0.0)
        editor.apply(DrawResult(is_pending_ready=True))


def step_of(editor: Editor) -> int:
    """Number of deleted Gaussians."""
    marked = editor.document.scene.members[0].marks.deleted if editor.document.scene.members else None
    return 0 if marked is None else marked.size


def recovered(home: Path) -> Editor:
    """A editor with all that there is of the scene."""
    editor = Editor()
    editor.files.open(str(home))
    editor.files.recovery.look()
    settle(editor)
    if editor.status.problem is not None:
        raise ValueError(editor.status.problem)
    answered(editor, "Recover")
    return editor


def answered(editor: Editor, label: str) -> None:
    """Answer what is asked, if anything is."""
    if editor.status.question is not None:
        editor.status.answer(next(each for each in editor.status.question.answers if each.label == label))
        settle(editor)


def work_on(home: Path) -> int:
    """Edit, keep and save a few times; says what is safe."""
    editor = recovered(home)
    first = step_of(editor) + 1
    for number in range(first, first + _STEPS):
        member = editor.document.scene.members[0]
        deleted = BitMask.of(np.arange(len(member.gaussians)) < number)
        editor.document.edit(
            "Delete",
            replace_scene,
            editor.document.scene.with_member(member.key, marks=SelectionFlags(deleted=deleted)),
        )
        editor.tick(0.0)
        late = editor.files.recovery.now() + 1000
        editor.files.recovery.now = lambda late=late: late
        settle(editor)
        print("safe", number, flush=True)
        if number % 2:
            editor.files.save()
            settle(editor)
            answered(editor, "Overwrite")  # it was killed between the save and the end of the autosave
            assert not editor.files.has_changes
        if editor.status.problem is not None:
            raise ValueError(editor.status.problem)
    editor.files.save()
    settle(editor)
    editor.close()
    return 0


def look(home: Path) -> int:
    """Say which step there is, and end as a window does that is not answered."""
    editor = recovered(home)
    print("found", step_of(editor), flush=True)
    editor.close()
    return 0


def main() -> None:
    """Kill and tell."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--deaths", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    chance, faults, deaths = random.Random(arguments.seed), 0, 0
    with tempfile.TemporaryDirectory() as place:
        os.environ["XDG_STATE_HOME"] = os.environ["XDG_CONFIG_HOME"] = place
        home, said = Path(place) / "scenes" / "crossing", Path(place) / "said.txt"
        write_scene(small_scene("crossing"), home)
        _, count = run_in_child(partial(work_on, home), 0, said)
        for _ in range(arguments.deaths):
            at = chance.randint(1, count)
            code, _ = run_in_child(partial(work_on, home), at, said)
            told = said.read_text()
            deaths += code == -signal.SIGKILL
            safe = max((int(line.split()[1]) for line in told.splitlines() if line.startswith("safe")), default=0)
            ended, _ = run_in_child(partial(look, home), None, said)
            found = [int(line.split()[1]) for line in said.read_text().splitlines() if line.startswith("found")]
            if code not in (0, -signal.SIGKILL) or ended != 0 or not found or found[0] < safe:
                faults += 1
                words = f"{code}, {ended}: safe {safe}, found {found}: {said.read_text()[-400:]}"
                print(f"killed at {at} of {count}: {words}")
        run_in_child(partial(work_on, home), None, said)
        left = sorted(str(each.relative_to(place)) for each in home.parent.iterdir() if each != home)
        unsaved = Path(place) / "gsrain" / "unsaved"
        left += [str(each) for each in unsaved.glob("*")]
        print(f"{deaths} deaths, {faults} complaints; left behind: {left or 'nothing'}")


if __name__ == "__main__":
    main()
