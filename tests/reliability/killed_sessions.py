"""Kills sessions at random calls that change the disk, while they edit, keep and save, and recovers what they had.

`python tests/reliability/killed_sessions.py [--deaths 40] [--seed 0]`, on a system that can fork. Not a test. A session
deletes one Gaussian more at each step, and says when that was kept by the autosave or saved. After each death the next
session has to open the scene, to offer what was kept, and to have at least all steps that were said to be safe.
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


def settle(session: Editor) -> None:
    """Let background work end and take it in, without a live view."""
    for _ in range(4):
        wait(session.pending_files, timeout=60)
        session.update(0.0)
        session.swap_in()


def step_of(session: Editor) -> int:
    """Number of deleted Gaussians."""
    marked = session.scene.members[0].marks.deleted if session.scene.members else None
    return 0 if marked is None else marked.size


def recovered(home: Path) -> Editor:
    """A session with all that there is of the scene."""
    session = Editor()
    session.open(str(home))
    session.files.recovery.look()
    settle(session)
    if session.problem is not None:
        raise ValueError(session.problem)
    answered(session, "Recover")
    return session


def answered(session: Editor, label: str) -> None:
    """Answer what is asked, if anything is."""
    if session.questions.present is not None:
        session.questions.answer(next(each for each in session.questions.present.answers if each.label == label))
        settle(session)


def work_on(home: Path) -> int:
    """Edit, keep and save a few times; says what is safe."""
    session = recovered(home)
    first = step_of(session) + 1
    for number in range(first, first + _STEPS):
        member = session.scene.members[0]
        deleted = BitMask.of(np.arange(len(member.gaussians)) < number)
        session.set_scene("Delete", session.scene.with_member(member.key, marks=SelectionFlags(deleted=deleted)))
        session.update(0.0)
        late = session.files.recovery.now() + 1000
        session.files.recovery.now = lambda late=late: late
        settle(session)
        print("safe", number, flush=True)
        if number % 2:
            session.files.save()
            settle(session)
            answered(session, "Overwrite")  # it was killed between the save and the end of the autosave
            assert not session.has_changes
        if session.problem is not None:
            raise ValueError(session.problem)
    session.files.save()
    settle(session)
    session.close()
    return 0


def look(home: Path) -> int:
    """Say which step there is, and end as a window does that is not answered."""
    session = recovered(home)
    print("found", step_of(session), flush=True)
    session.close()
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
