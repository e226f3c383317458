"""Kills editing sessions at random calls that change the disk, while they edit, autosave and save, and recovers them.

`python tests/reliability/killed_sessions.py [--deaths 40] [--seed 0]`, on a system that can fork. Not a test. An editor
deletes one Gaussian more at each step, and prints when that was autosaved or saved. After each death the next editor
has to open the scene, to offer the autosave, and to have at least all steps that were printed.
"""

import argparse
import os
import random
import signal
import sys
import tempfile
from functools import partial
from pathlib import Path

os.environ["NUMBA_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from gsrain_engine.editor.editor import Editor  # noqa: E402
from gsrain_engine.scene.formats.scene_files import write_scene  # noqa: E402
from reliability.dying import run_in_child  # noqa: E402
from reliability.editors import answer, autosave_now, delete_first, deleted_in, opened, settle  # noqa: E402
from small_scene import small_scene  # noqa: E402

_STEPS = 6


def recovered(home: Path) -> Editor:
    """An editor with all that there is of the scene."""
    editor = opened(home)
    editor.files.recovery.look()
    settle(editor)
    answer_if_asked(editor, "Recover")
    return editor


def answer_if_asked(editor: Editor, label: str) -> None:
    if editor.status.question is not None:
        answer(editor, label)
    if editor.status.problem is not None:
        raise ValueError(editor.status.problem)


def edit_and_save(home: Path) -> int:
    """Edit, autosave and save a few times; prints the steps that are safe."""
    editor = recovered(home)
    first = deleted_in(editor.document.scene) + 1
    for number in range(first, first + _STEPS):
        delete_first(editor, number)
        autosave_now(editor)
        print("safe", number, flush=True)
        if number % 2:
            editor.files.save()
            settle(editor)
            answer_if_asked(editor, "Overwrite")  # killed between the save and the end of the autosave
            assert not editor.files.has_changes
    editor.files.save()
    settle(editor)
    editor.close()
    return 0


def print_step(home: Path) -> int:
    editor = recovered(home)
    print("found", deleted_in(editor.document.scene), flush=True)
    editor.close()
    return 0


def steps(output: Path, word: str) -> list[int]:
    return [int(line.split()[1]) for line in output.read_text().splitlines() if line.startswith(word)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--deaths", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    chance, faults, deaths = random.Random(arguments.seed), 0, 0
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        os.environ["XDG_STATE_HOME"] = os.environ["XDG_CONFIG_HOME"] = folder
        home, output = place / "scenes" / "crossing", place / "output.txt"
        write_scene(small_scene("crossing"), home)
        _, count = run_in_child(partial(edit_and_save, home), 0, output)
        for _ in range(arguments.deaths):
            at = chance.randint(1, count)
            code, _ = run_in_child(partial(edit_and_save, home), at, output)
            deaths += code == -signal.SIGKILL
            safe = max(steps(output, "safe"), default=0)
            ended, _ = run_in_child(partial(print_step, home), None, output)
            found = steps(output, "found")
            if code not in (0, -signal.SIGKILL) or ended != 0 or not found or found[0] < safe:
                faults += 1
                print(f"killed at {at} of {count}: {code}, {ended}: safe {safe}, found {found}")
                print(output.read_text()[-400:])
        run_in_child(partial(edit_and_save, home), None, output)
        left = [*(each for each in home.parent.iterdir() if each != home), *(place / "gsrain" / "unsaved").glob("*")]
        print(f"{deaths} deaths, {faults} complaints; left behind: {left or 'nothing'}")


if __name__ == "__main__":
    main()
