"""Does the window stay as it is for hours? Drives the real window, and writes what it holds every few seconds.

A person's work, random by a seed, goes on and on: scenes are opened, played, rained on, edited, recorded, transferred,
driven through, saved and opened again (`soak_person.py`). Resident memory, threads, open files, processes and OpenGL
objects go into a CSV file; figures of moments in which nothing is open are compared. Prints JSON, then a line. Without
a display: `xvfb-run -a`. Preferences, recent files and autosaves are in the output folder, not a person's own.
"""

import argparse
import csv
import ctypes
import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import psutil
from imgui_bundle import hello_imgui, immapp

_KINDS = ("Buffer", "Texture", "Framebuffer", "Program", "VertexArray", "Query")
_MOST_NAMES = 8192
"""Mesa numbers objects of a kind from 1, and takes the lowest number that is free."""
_SETTLED = 1 / 4
"""Share of the run in which caches fill: figures are compared after it."""
_FRAME_S = 0.1
"""Least time of a frame: a person does no more in it, and the machine has other things to do."""


class Sample(NamedTuple):
    """Resources of the program at a moment."""

    seconds: float
    cycle: int
    doing: str
    at_rest: bool
    rss_mb: float
    threads: int
    files: int
    children: int
    gl_objects: int


def main() -> None:
    """Soak and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=4.0)
    parser.add_argument("--every", type=float, default=10.0, help="seconds between two lines of the CSV file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path, default=Path("soak"), help="folder for everything that is written")
    parser.add_argument("scenes", nargs="*", default=["street"], help="scene files or folders, opened in turn")
    arguments = parser.parse_args()
    folder = arguments.output.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    os.environ["XDG_STATE_HOME"] = os.environ["XDG_CONFIG_HOME"] = os.environ["XDG_DATA_HOME"] = str(folder)
    samples: list[Sample] = []
    problems = soak(arguments, folder, samples)
    told = summary(samples)
    print(json.dumps({"scenes": arguments.scenes, **told, "problems": problems}, indent=1))
    print(
        f"{told['minutes']:.0f} min, {told['rests']} times at rest: {told['rss_mb_per_hour']:+.1f} MB an hour on "
        f"{told['rss_mb']:.0f} MB ({told['rss_change_percent']:+.1f} % from the second quarter to the last)"
    )


def soak(arguments: Any, folder: Path, samples: list[Sample]) -> list[str]:
    """Open the window and work in it; returns what the program complained of."""
    from soak_person import Person

    from ui.window import MainWindow, begin_editor

    window = MainWindow(lambda: begin_editor(arguments.scenes[0], None))
    parameters = window.parameters()
    parameters.ini_disable = True
    parameters.app_window_params.window_geometry.size = (1100, 720)
    update: Callable[[], None] = parameters.callbacks.pre_new_frame
    end_at = time.monotonic() + 3600 * arguments.hours
    people: list[tuple[Person, Iterator[None]]] = []
    due = [0.0]

    def frame() -> None:
        time.sleep(max(0.0, due[0] - time.monotonic()))
        due[0] = time.monotonic() + _FRAME_S
        update()
        if window.workspace is None:
            return
        if not people:
            person = Person(window.workspace.editor, arguments.scenes, folder, arguments.seed)
            people.append((person, person.steps()))
            gauge.watch(person)
        person, steps = people[0]
        parameters.fps_idling.enable_idling = False  # somebody works
        person.look_after()
        next(steps)
        if person.is_at_rest:
            gauge.take(gl_objects=count_gl_objects())
        if time.monotonic() > end_at:
            window.workspace.editor.files.give_up()
            hello_imgui.get_runner_params().app_shall_exit = True

    gauge = Gauge(folder / "soak.csv", samples, arguments.every)
    parameters.callbacks.pre_new_frame = frame
    try:
        immapp.run(parameters, immapp.AddOnsParams(with_implot=False))
    finally:
        window.close()
        gauge.close()
    return people[0][0].problems if people else ["the window never came up"]


class Gauge:
    """Writes samples to a file, from a thread of its own every so often and from the window's when asked."""

    def __init__(self, file: Path, samples: list[Sample], every_s: float) -> None:
        self._samples, self._every_s = samples, every_s
        self._process, self._began = psutil.Process(), time.monotonic()
        self._stream = file.open("w", newline="", encoding="utf-8")
        self._rows = csv.writer(self._stream)
        self._rows.writerow(Sample._fields)
        self._lock, self._end = threading.Lock(), threading.Event()
        self._gl_objects = 0
        self._person: Any = None

    def watch(self, person: Any) -> None:
        """Begin."""
        self._person = person
        threading.Thread(target=self._run, name="gauge", daemon=True).start()

    def take(self, gl_objects: int | None = None) -> None:
        """Take a sample now."""
        process, person = self._process, self._person
        self._gl_objects = self._gl_objects if gl_objects is None else gl_objects
        sample = Sample(
            round(time.monotonic() - self._began, 2), person.cycles, person.doing, gl_objects is not None,
            round(process.memory_info().rss / 1e6, 2), process.num_threads(), process.num_fds(),
            len(process.children(recursive=True)), self._gl_objects,
        )  # fmt: skip
        with self._lock:
            self._samples.append(sample)
            self._rows.writerow(sample)
            self._stream.flush()

    def close(self) -> None:
        """End."""
        self._end.set()
        self._stream.close()

    def _run(self) -> None:
        while not self._end.wait(self._every_s):
            self.take()


def count_gl_objects() -> int:
    """Ask the driver which names are objects, in the window's context."""
    import glfw

    count = 0
    for kind in _KINDS:
        address = ctypes.cast(glfw.get_proc_address(f"glIs{kind}"), ctypes.c_void_p).value
        exists = ctypes.CFUNCTYPE(ctypes.c_ubyte, ctypes.c_uint)(address or 0)
        count += sum(exists(name) for name in range(1, _MOST_NAMES))
    return count


def summary(samples: list[Sample]) -> dict[str, Any]:
    """Compare moments at rest: slope of a line through memory after the first quarter, and range of all else."""
    rests = [each for each in samples if each.at_rest]
    end = samples[-1].seconds if samples else 0.0
    late = [each for each in rests if each.seconds > _SETTLED * end] or rests
    seconds, rss = np.array([each.seconds for each in late]), np.array([each.rss_mb for each in late])
    slope = float(np.polyfit(seconds, rss, 1)[0]) * 3600 if len(late) > 2 else float("nan")
    early = rss[seconds < 2 * _SETTLED * end]
    last = rss[seconds > (1 - _SETTLED) * end]
    change = 100 * (last.mean() / early.mean() - 1) if len(early) and len(last) else float("nan")
    return {
        "minutes": round(end / 60, 1),
        "cycles": samples[-1].cycle if samples else 0,
        "rests": len(rests),
        "rss_mb": round(float(rss.mean()), 1) if len(rss) else float("nan"),
        "rss_mb_per_hour": round(slope, 2),
        "rss_change_percent": round(float(change), 2),
        "largest_rss_mb": max((each.rss_mb for each in samples), default=0.0),
        **{
            name: [min(values), max(values)]
            for name in ("threads", "files", "children", "gl_objects")
            if (values := [getattr(each, name) for each in late])
        },
    }


if __name__ == "__main__":
    main()
