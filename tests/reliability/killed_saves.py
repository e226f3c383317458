"""Saves scenes in processes that die right before each of their calls that change the disk, and reads what is left.

Run as a program with an empty folder: prints a line for each fault, and last how many processes have died.
"""

import signal
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from gsrain_engine.scene.flags import BitMask, SelectionFlags  # noqa: E402
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene  # noqa: E402
from gsrain_engine.scene.formats.scene_folder import FileCache  # noqa: E402
from gsrain_engine.scene.gaussians import Gaussians  # noqa: E402
from gsrain_engine.scene.scene import Layer, Scene  # noqa: E402
from reliability.dying import run_in_child  # noqa: E402

COUNT = 3000


def scene(number: int) -> Scene:
    """A scene with its number in all that it holds; each third one has the Gaussians of the one before."""
    value = number - 1 if number % 3 == 2 else number
    numbers = np.full((COUNT, 3), value, np.float32)
    turns = np.tile(np.array([1, 0, 0, 0], np.float32), (COUNT, 1))
    gaussians = Gaussians(numbers, np.ones_like(numbers), turns, np.full(COUNT, 0.5, np.float32), numbers[:, None])
    marks = SelectionFlags(deleted=BitMask.of(np.arange(COUNT) < number))
    return Scene(str(number), (Layer("first", gaussians, marks=marks), Layer("second", gaussians)))


def fault(folder: Path) -> str | None:
    """Defect of the saved folder; None if it is one of the scenes, complete."""
    try:
        found = read_scene(folder)
    except ValueError as error:
        return str(error)
    expected = scene(int(found.name))
    for layer, right in zip(found.layers, expected.layers, strict=True):
        if not np.array_equal(layer.gaussians.means, right.gaussians.means):
            return f"scene {found.name} holds the Gaussians of another"
    deleted = found.layers[0].marks.deleted
    return None if deleted is not None and deleted.size == int(found.name) else f"scene {found.name} has other marks"


def save_three(folder: Path, first: int) -> int:
    """Save the next three scenes, of which one changes only marks, so that its files are known."""
    known, gaussians = FileCache(), scene(first).layers[0].gaussians
    for number in range(first, first + 3):
        made = scene(number)
        if number % 3 == 2 and number > first:
            made = replace(made, layers=tuple(replace(each, gaussians=gaussians) for each in made.layers))
        gaussians = made.layers[0].gaussians
        write_scene(made, folder, known)
    return 0


def main(folder: Path) -> None:
    """Let one process after the other die, each one call later than the one before, until one comes to its end.

    After each, the next writer has to find a complete scene, and to remove all that the dead one has left.
    """
    said = folder.with_name("said.txt")
    at, code, number = 0, -signal.SIGKILL, 1
    while code == -signal.SIGKILL:
        at += 1
        write_scene(scene(number), folder)
        if len(left := [each.name for each in folder.parent.rglob("*") if each.is_file() and each != said]) != 3:
            print(f"left behind by the death before {at}: {left}")
        code, _ = run_in_child(partial(save_three, folder, number + 1), at, said)
        if (wrong := fault(folder)) is not None:
            print(f"killed at {at}: {wrong}")
        number = int(read_scene(folder).name) + 1
    if code != 0:
        print(f"ended with {code}: {said.read_text()}")
    print(f"{at - 1} deaths")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
