"""Processor time of the idle window. Prints JSON, then a line.

Opens the real window with a scene in its rain, time paused, waits until all has settled, and takes the processor's
time of all threads of the process meanwhile. Without a display: `xvfb-run -a`.
"""

import argparse
import json
import threading
import time

from imgui_bundle import hello_imgui, imgui, immapp

from gsrain_engine.editor.editor import Editor
from gsrain_engine.rain.settings import load_preset
from gsrain_engine.render.renderer import describe_machine
from ui.window import MainWindow, begin_editor

_LONGEST_S = 300.0
_SETTLED_S = 3.0


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="street")
    parser.add_argument("--seconds", type=float, default=20.0)
    arguments = parser.parse_args()

    def begin() -> Editor:
        editor = begin_editor(arguments.scene, load_preset("8.5"))
        editor.playback.clock.playing = False
        return editor

    window = MainWindow(begin)
    found: dict[str, float] = {}
    watcher = threading.Thread(target=_watch, args=(window, arguments.seconds, found), daemon=True)
    parameters = window.parameters()
    parameters.ini_disable = True
    watcher.start()
    immapp.run(parameters, immapp.AddOnsParams(with_implot=False))
    print(json.dumps({"scene": arguments.scene, **found, "machine": describe_machine()}, indent=1))
    print(f"idle: {found['share_of_a_core']:.1%} of a core, {found['frames_per_second']:.1f} frames a second")


def _watch(window: MainWindow, seconds: float, found: dict[str, float]) -> None:
    """Measure from another thread, which the window's own knows nothing of; then close the window."""
    until, quiet_since = time.monotonic() + _LONGEST_S, time.monotonic()
    while time.monotonic() < until and time.monotonic() - quiet_since < _SETTLED_S:
        time.sleep(0.1)
        workspace = window.workspace
        if workspace is None or workspace.editor.is_working or not workspace.pictures.is_current:
            quiet_since = time.monotonic()
    frames, work, start = imgui.get_frame_count(), time.process_time(), time.monotonic()
    time.sleep(seconds)
    took = time.monotonic() - start
    found["seconds"] = round(took, 2)
    found["share_of_a_core"] = round((time.process_time() - work) / took, 4)
    found["frames_per_second"] = round((imgui.get_frame_count() - frames) / took, 2)
    hello_imgui.get_runner_params().app_shall_exit = True


if __name__ == "__main__":
    main()
