"""Does a job keep reporting while the window plays, and does the window keep its frame rate? Prints JSON, then a line.

The real window plays the built-in street in rain: alone, then while a job works in its own process. `recolor` makes the
street rainy, `training` reconstructs a capture of the street. Without a display: `xvfb-run -s "-screen 0 1100x720x24"`.
"""

import argparse
import json
import tempfile
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from statistics import median, quantiles

import psutil
from imgui_bundle import hello_imgui, immapp
from reconstruct_street import street_capture

from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.job_results import scene_results
from gsrain_engine.editor.jobs.training import reconstruction_job
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.render.renderer import describe_machine
from gsrain_engine.scene.progress import Progress
from gsrain_engine.training.settings import load_settings
from ui.window import MainWindow
from ui.workspace import Workspace


class Measurement:
    """Frame times of a playing window, then the same with a job and the times of its messages. Called once a frame."""

    def __init__(self, seconds: float, start: Callable[[Editor], None]) -> None:
        self.alone: list[float] = []
        self.with_job: list[float] = []
        self.messages: list[float] = []
        self.last_step = Progress(0.0, "")
        self.job_cores = 0.0
        """Processor seconds of the job's process per second."""
        self.statistics: dict[str, float | str] = {}
        """Of the viewport's last frame."""
        self._seconds, self._start = seconds, start
        self._begins = self._frame = 0.0
        self._is_idle = True

    def frame(self, workspace: Workspace) -> None:
        editor, now = workspace.editor, time.perf_counter()
        frame_s, self._frame = now - self._frame, now
        if editor.busy is not None or editor.viewport.staged is not None or not editor.document.scene.gaussian_count:
            editor.playback.clock.playing = True
            self._begins = now + 3.0  # the quality of frames has settled then
        elif now < self._begins:
            pass
        elif now < self._begins + self._seconds:
            self.alone.append(frame_s)
        elif self._is_idle:
            self._is_idle = False
            self._start(editor)
        else:
            self._with_job(editor, now, frame_s)

    def _with_job(self, editor: Editor, now: float, frame_s: float) -> None:
        job = editor.jobs.all[-1]
        self.with_job.append(frame_s)
        if not self.messages or job.progress[:2] != self.last_step[:2]:
            self.messages.append(now)
            self.last_step = job.progress
        if job.state != "running" or now > self.messages[0] + self._seconds:
            self.messages.append(now)
            workers = [each for each in psutil.Process().children() if "--multiprocessing-fork" in each.cmdline()]
            self.job_cores = sum(sum(each.cpu_times()[:2]) for each in workers) / (now - self.messages[0])
            self.statistics = {
                "backend": editor.viewport.backend,
                "detail": str(editor.viewport.detail),
                **editor.viewport.statistics,
            }
            hello_imgui.get_runner_params().app_shall_exit = True


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("job", choices=("recolor", "training"))
    parser.add_argument("--seconds", type=float, default=60.0, help="of each of the two measurements")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        start = _make_rainy if arguments.job == "recolor" else _train(Path(folder))
        measurement = Measurement(arguments.seconds, start)

        def begin() -> Editor:
            editor = Editor(rain=load_preset("8.5"))
            editor.files.open("street")
            return editor

        window = MainWindow(begin, on_frame=measurement.frame)
        parameters = window.parameters()
        parameters.ini_disable = True
        parameters.app_window_params.window_geometry.size = (1100, 720)  # px
        threading.Thread(target=_stop_after, args=(600.0,), daemon=True).start()
        immapp.run(parameters, immapp.AddOnsParams(with_implot=False))
        window.close()
    gaps = [after - before for before, after in pairwise(measurement.messages)]
    found = {
        "alone": _summary(measurement.alone),
        "with job": _summary(measurement.with_job),
        "messages": len(gaps),
        "longest_gap_s": round(max(gaps), 1),
        "job_cores": round(measurement.job_cores, 2),
        "last_message": measurement.last_step.message,
        "viewport": measurement.statistics,
        "machine": describe_machine(),
    }
    print(json.dumps(found, indent=1))
    ratio = found["with job"]["median_ms"] / found["alone"]["median_ms"]
    print(f"a frame with the job takes {ratio:.2f} times as long as alone; longest silence {max(gaps):.1f} s")


def _make_rainy(editor: Editor) -> None:
    editor.wet_look.make()


def _train(folder: Path) -> Callable[[Editor], None]:
    """Write a capture of the street; returns what trains on it."""
    for _ in write_views(folder / "street", street_capture(with_depth=False, camera_count=1)):
        pass

    def start(editor: Editor) -> None:
        job = reconstruction_job(folder / "street", load_settings("laptop", measured_every=0))
        editor.jobs.start(job, scene_results(editor.viewport, job.title, is_whole=True))

    return start


def _stop_after(seconds: float) -> None:
    time.sleep(seconds)
    hello_imgui.get_runner_params().app_shall_exit = True


def _summary(frames_s: list[float]) -> dict[str, float]:
    return {
        "frames": len(frames_s),
        "median_ms": round(1e3 * median(frames_s), 1),
        "percentile_95_ms": round(1e3 * quantiles(frames_s, n=20)[-1], 1),
        "longest_ms": round(1e3 * max(frames_s), 1),
    }


if __name__ == "__main__":
    main()
