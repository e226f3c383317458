"""Saves a scene again and again in processes that die in the middle, and looks at what is left each time.

Run as a program with an empty folder: prints one line for each thing that is wrong, and last how often a process died.
"""

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from gsrain_engine.scene.formats.scene_folder import FileCache
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import Layer, Scene

COUNT = 3000
RANDOM_DEATHS = 30
STEPS = 170
"""More than two saves take."""
_CALLS = {"open", "write", "fsync", "close", "replace", "rename", "unlink", "mkdir", "link", "flock", "scandir"}


def scene(number: int) -> Scene:
    """A scene that tells its number in everything that it holds; each third one has the Gaussians of the one before."""
    value = number - 1 if number % 3 == 2 else number
    numbers = np.full((COUNT, 3), value, np.float32)
    gaussians = Gaussians(
        numbers,
        np.ones((COUNT, 3), np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (COUNT, 1)),
        np.full(COUNT, 0.5, np.float32),
        numbers[:, None],
    )
    marks = SelectionFlags(deleted=BitMask.of(np.arange(COUNT) < number))
    return Scene(str(number), (Layer("first", gaussians, marks=marks), Layer("second", gaussians)))


def complaint(folder: Path) -> str | None:
    """Defect of the saved folder; None if it is one of the scenes, complete."""
    try:
        found = read_scene(folder)
    except ValueError as error:
        return str(error)
    number = int(found.name)
    expected = scene(number)
    for layer, right in zip(found.layers, expected.layers, strict=True):
        if not np.array_equal(layer.gaussians.means, right.gaussians.means):
            return f"scene {number} holds the Gaussians of another"
    deleted = found.layers[0].marks.deleted
    return None if deleted is not None and deleted.size == number else f"scene {number} has the marks of another"


def save_on(folder: Path, first: int) -> None:
    """Save one scene after the other until the process dies."""
    known, gaussians = FileCache(), scene(first).layers[0].gaussians
    for number in range(first, COUNT):
        made = scene(number)
        if number % 3 == 2 and number > first:  # only marks change: the files are known
            made = replace(made, layers=tuple(replace(each, gaussians=gaussians) for each in made.layers))
        gaussians = made.layers[0].gaussians
        write_scene(made, folder, known)


def die_at_step(step: int) -> None:
    """Kill this process right before or after one of its calls that touch the disk, the so-manieth from now."""
    steps = [0]

    def count(_: object, event: str, function: object) -> None:
        if event in ("c_call", "c_return") and getattr(function, "__name__", "") in _CALLS:
            steps[0] += 1
            if steps[0] == step:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.setprofile(count)


def main(folder: Path) -> None:
    """Let one process after the other die."""
    random = np.random.default_rng(0)
    deaths = 0
    write_scene(scene(1), folder)
    random_moments = [("moment", float(seconds)) for seconds in random.uniform(0.001, 0.06, RANDOM_DEATHS)]
    for kind, when in [*random_moments, *(("step", step) for step in range(1, STEPS))]:
        first = int(read_scene(folder).name) + 1
        child = os.fork()
        if child == 0:
            if kind == "moment":
                signal.setitimer(signal.ITIMER_REAL, when)  # nobody handles it: the process is gone
            else:
                die_at_step(int(when))
            save_on(folder, first)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        deaths += os.WIFSIGNALED(status)
        wrong = complaint(folder)
        if wrong is not None:
            print(f"{kind} {when}: {wrong}")
    last = int(read_scene(folder).name) + 1
    write_scene(scene(last), folder)
    left = sorted(str(each.relative_to(folder.parent)) for each in folder.parent.rglob("*") if each.is_file())
    if len(left) != 3:
        print(f"left behind: {left}")
    print(f"{deaths} deaths, {last - 1} saves")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
