"""Saves killed right before each of their calls that change the disk: the old scene is complete, or the new one.

Run as a program with a folder, it kills one process after the other, each one call later, until one finishes. It prints
a line for each fault, and last the number of deaths.
"""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.formats.scene_folder import FileCache
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Layer, Scene
from reliability.dying import run_in_child

COUNT = 3000


def scene(number: int) -> Scene:
    """A scene whose values are its number; each third one has the Gaussians of the one before."""
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
    """Save three scenes, one of which only changes flags, so that its files are reused."""
    known, gaussians = FileCache(), scene(first).layers[0].gaussians
    for number in range(first, first + 3):
        made = scene(number)
        if number % 3 == 2 and number > first:
            made = replace(made, layers=tuple(replace(each, gaussians=gaussians) for each in made.layers))
        gaussians = made.layers[0].gaussians
        write_scene(made, folder, known)
    return 0


def main(folder: Path) -> None:
    output = folder.with_name("output.txt")
    at, code, number = 0, -signal.SIGKILL, 1
    while code == -signal.SIGKILL:
        at += 1
        write_scene(scene(number), folder)  # removes all that the dead process has left
        left = [each.name for each in folder.parent.rglob("*") if each.is_file() and each != output]
        if len(left) != 3:
            print(f"left behind by the death before {at}: {left}")
        code, _ = run_in_child(partial(save_three, folder, number + 1), at, output)
        if (wrong := fault(folder)) is not None:
            print(f"killed at {at}: {wrong}")
        number = int(read_scene(folder).name) + 1
    if code != 0:
        print(f"ended with {code}: {output.read_text()}")
    print(f"{at - 1} deaths")


@pytest.mark.skipif(os.name != "posix", reason="needs fork")
def test_killed_saves_leave_a_complete_scene(tmp_path: Path) -> None:
    paths = os.pathsep.join(map(str, Path(__file__).parents[1:3]))
    command, environment = [sys.executable, __file__, tmp_path / "scene"], os.environ | {"PYTHONPATH": paths}
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    *faults, last = run.stdout.splitlines()
    assert faults == []
    assert int(last.split()[0]) > 50


if __name__ == "__main__":
    main(Path(sys.argv[1]))
