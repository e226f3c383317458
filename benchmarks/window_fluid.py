"""Does the window stay fluid while its viewport plays and a job works? Prints JSON, then a line for each phase.

The real window plays the built-in street in 8.5 mm/h: alone, then while a job works in its own process; first a second
client of the X server moves the mouse, then nobody does, then the camera orbits. The time until the window has shown a
frame with the mouse at its new place is the feedback. `record` renders a video of the drive, `recolor` makes the street
rainy, `training` reconstructs a capture of the street, `none` measures the window alone. Without a display:
`xvfb-run -s "-screen 0 1600x1000x24"`; `taskset -c 0,1` gives it two cores.
"""

import argparse
import json
import random
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from statistics import median, quantiles
from typing import Any

import psutil
from imgui_bundle import hello_imgui, imgui, immapp
from reconstruct_street import street_capture
from window_motion import Hand

from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.editor.background_edits import reconstruct
from gsrain_engine.editor.document import Recipe
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.job_results import scene_results
from gsrain_engine.editor.jobs.training import reconstruction_job
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.render.renderer import describe_machine
from gsrain_engine.training.settings import load_settings
from ui.window import MainWindow
from ui.workspace import Workspace

_PHASES = ("mouse", "watched", "orbit", "job, mouse", "job, watched", "job, orbit")
_ORBIT_RAD_S = 0.3
_SETTLING_S = 6.0  # the quality of pictures has settled then
_LONGEST_S = 900.0
_MOVES_EVERY_S = (0.1, 0.5)
_WINDOW_PX = (1472, 967)
_SPLITS = {"RightSpace": 0.17, "LeftSpace": 0.2, "BottomSpace": 0.22}  # shares at which the viewport has 960x640


@dataclass
class Phase:
    """Measurements of the window, alone or with a job."""

    begins_s: float = 0.0
    ends_s: float = 0.0
    frames_s: list[float] = field(default_factory=list[float])
    """Time of each frame of the interface."""
    feedback_s: list[float] = field(default_factory=list[float])
    pictures: list[tuple[float, int, int, str]] = field(default_factory=list[tuple[float, int, int, str]])
    """Drawing time in ms, size and quality of each picture."""
    job_s: float = 0.0
    """Processor time of the job."""

    def summary(self) -> dict[str, Any]:
        seconds = self.ends_s - self.begins_s
        steps = [1e3 * (after - before) for before, after in pairwise(self.frames_s)]
        sizes = sorted((width, height, detail) for _, width, height, detail in self.pictures)
        return {
            "seconds": round(seconds, 1),
            "interface_frames_per_s": round(len(steps) / seconds, 1),
            "interface_ms": _spread(steps),
            "feedback_ms": _spread([1e3 * each for each in self.feedback_s]),
            "pictures_per_s": round(len(self.pictures) / seconds, 1),
            "picture_ms": _spread([each[0] for each in self.pictures]),
            "picture_size_median": sizes[len(sizes) // 2] if sizes else None,
            "job_cores": round(self.job_s / seconds, 2),
        }


class Measurement:
    """Measures a playing window, then the same with a job. `frame` is called once per frame of the interface."""

    def __init__(self, seconds: float, start: Callable[[Editor], None] | None) -> None:
        self._names = [name for name in _PHASES if start is not None or not name.startswith("job")]
        self.phases = {name: Phase() for name in self._names}
        self.last_message = ""
        self.viewport_px = (0, 0)
        self._seconds, self._start = seconds, start
        self._name = ""
        self._phase: Phase | None = None
        self._mouse = Mouse()
        self._is_counting = False

    def frame(self, workspace: Workspace) -> None:
        editor, now = workspace.editor, time.perf_counter()
        if not self._is_counting:
            self._is_counting, apply = True, editor.apply
            editor.apply = lambda result: (self._count(result), apply(result))[1]  # type: ignore[method-assign]
        if not editor.document.scene.gaussian_count or (self._phase is None and editor.busy is not None):
            return
        if self._phase is None:
            self._begin(self._names[0], now)
        elif now >= self._phase.ends_s:
            self._phase.job_s += _worker_s()
            if self._name == self._names[-1]:
                hello_imgui.get_runner_params().app_shall_exit = True
                return
            self._begin(self._names[self._names.index(self._name) + 1], now)
            if not editor.jobs.all and self._name.startswith("job") and self._start is not None:
                self._start(editor)
        if editor.jobs.all and editor.jobs.all[-1].state != "running":
            raise RuntimeError(f"the job ended early: {editor.jobs.all[-1].state}; measure fewer --seconds")
        if self._name.endswith("orbit"):
            turn = -1 if now % 2 < 1 else 1  # to and fro, before the same houses
            editor.viewport.orbit(turn * _ORBIT_RAD_S * imgui.get_io().delta_time, 0.0)
        if now >= self._phase.begins_s:
            if not self._phase.frames_s:
                self._phase.job_s = -_worker_s()
            self._phase.frames_s.append(now)
            self._phase.feedback_s += self._mouse.answered(now)
            if self._name.endswith("mouse"):
                self._mouse.move_at_times()
            self.last_message = editor.jobs.all[-1].progress.message if len(editor.jobs.all) else ""

    def _begin(self, name: str, now: float) -> None:
        self._name, self._phase = name, self.phases[name]
        phase = self._phase
        phase.begins_s = now + _SETTLING_S
        phase.ends_s = phase.begins_s + self._seconds

    def _count(self, result: Any) -> None:
        phase = self._phase
        if result.drawn is not None and phase is not None and phase.begins_s <= time.perf_counter() <= phase.ends_s:
            texture = result.textures[-1]
            row = result.drawn.frame_ms, texture.width, texture.height, str(result.drawn.quality)
            phase.pictures.append(row)
            self.viewport_px = tuple(round(each / result.drawn.quality.scale) for each in texture.size)


class Mouse:
    """Moves the mouse by the X server's test extension, and notes how long the window takes to show it."""

    def __init__(self) -> None:
        self._hand = Hand()
        self._random = random.Random(0)
        self._moved_s: float | None = None
        self._next_s = 0.0
        self._place = (-1.0, -1.0)

    def move_at_times(self) -> None:
        """Move once, after a random pause, from a thread of its own: at any moment of a frame."""
        now = time.perf_counter()
        if self._moved_s is None and now >= self._next_s:
            self._next_s = now + 10.0
            threading.Timer(self._random.uniform(*_MOVES_EVERY_S), self._move).start()

    def answered(self, now: float) -> list[float]:
        """Return the time since the last move if the frame before this one has shown it."""
        place, before = tuple(imgui.get_io().mouse_pos), self._place
        self._place = place
        if self._moved_s is None or place == before:
            return []
        took, self._moved_s, self._next_s = now - self._moved_s, None, 0.0
        return [took]

    def _move(self) -> None:
        x, y = self._random.randint(300, 1100), self._random.randint(100, 700)
        self._moved_s = time.perf_counter()
        self._hand.place(x, y)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("job", choices=("none", "record", "recolor", "training"))
    parser.add_argument("--seconds", type=float, default=20.0, help="of each phase")
    parser.add_argument("--backend", default="auto")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        jobs = {"record": _record, "recolor": _make_rainy, "training": _train}
        start = jobs[arguments.job](Path(folder)) if arguments.job in jobs else None
        measurement = Measurement(arguments.seconds, start)

        def begin() -> Editor:
            editor = Editor(rain=load_preset("8.5"))
            editor.files.open("street")
            return editor

        window = MainWindow(begin, arguments.backend, on_frame=measurement.frame)
        parameters = window.parameters()
        parameters.ini_disable = True
        parameters.app_window_params.window_geometry.size = _WINDOW_PX
        for split in parameters.docking_params.docking_splits:
            split.ratio = _SPLITS.get(split.new_dock, split.ratio)
        threading.Thread(target=_stop_after, args=(_LONGEST_S,), daemon=True).start()
        immapp.run(parameters, immapp.AddOnsParams(with_implot=False))
        window.close()
    if window.failure is not None:
        raise window.failure
    rows = {name: phase.summary() for name, phase in measurement.phases.items()}
    found = {
        **rows,
        "window_px": _WINDOW_PX,
        "viewport_px": measurement.viewport_px,
        "last_message": measurement.last_message,
        "machine": describe_machine(),
        "usable_cores": len(psutil.Process().cpu_affinity() or []),
    }
    print(json.dumps(found, indent=1))
    for name, row in rows.items():
        print(
            f"{name}: interface {row['interface_frames_per_s']} frames/s, "
            f"feedback {row['feedback_ms'].get('median')} ms (95 %: {row['feedback_ms'].get('95 %')}), "
            f"{row['pictures_per_s']} pictures/s of {row['picture_size_median']}, job {row['job_cores']} cores"
        )


def _worker_s() -> float:
    """Processor time of all worker processes."""
    workers = [each for each in psutil.Process().children() if "--multiprocessing-fork" in each.cmdline()]
    return sum(sum(each.cpu_times()[:2]) for each in workers)


def _record(folder: Path) -> Callable[[Editor], None]:
    return lambda editor: editor.render_queue.record_to(folder / "drive.mp4")


def _make_rainy(folder: Path) -> Callable[[Editor], None]:
    return lambda editor: editor.wet_look.make()


def _train(folder: Path) -> Callable[[Editor], None]:
    """Write a capture of the street; returns what trains on it."""
    for _ in write_views(folder / "street", street_capture(with_depth=False, camera_count=1)):
        pass

    def start(editor: Editor) -> None:
        settings = load_settings("laptop", measured_every=0)
        job = reconstruction_job(folder / "street", settings)
        recipe = Recipe(reconstruct, {"capture": folder / "street", "settings": settings, "allow_outside": False})
        editor.jobs.start(job, scene_results(editor.viewport, job.title, recipe, is_whole=True))

    return start


def _stop_after(seconds: float) -> None:
    time.sleep(seconds)
    hello_imgui.get_runner_params().app_shall_exit = True


def _spread(values: list[float]) -> dict[str, float]:
    if len(values) < 2:
        return {"count": len(values)}
    return {
        "count": len(values),
        "median": round(median(values), 1),
        "95 %": round(quantiles(values, n=20)[-1], 1),
        "longest": round(max(values), 1),
    }


if __name__ == "__main__":
    main()
