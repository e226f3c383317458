"""Commands that open a window, as printed, by an installed program under Xvfb: the window shows the scene."""

import os
import re
import shlex
import shutil
import subprocess
import time

import numpy as np
import pytest
from PIL import ImageGrab

from gsrain_engine.scene.formats.scene_files import write_scene
from repository import REPOSITORY
from small_scene import small_scene

pytestmark = pytest.mark.skipif(
    not (os.environ.get("DISPLAY") or shutil.which("Xvfb")), reason="no display and no Xvfb (Debian: xvfb)"
)
PICTURE_COLORS = 1000
"""A window without a picture of a scene has some 200."""
_LONGEST_S = 300.0


def demo() -> str:
    """Return the command of `make demo` where there is a display."""
    (line,) = re.findall(r"\$\(RUN\)/(gsrain .*--follow-path);", (REPOSITORY / "Makefile").read_text("utf-8"))
    return line


def colors_on_screen() -> int:
    pixels = np.asarray(ImageGrab.grab(xdisplay=os.environ["DISPLAY"]).convert("RGBA"))[::3, ::3].copy()
    return len(np.unique(pixels.view(np.uint32)))


@pytest.mark.parametrize("command", [demo(), "gsrain garden.ply --preset 8.5"])
def test_the_window_shows_the_scene(command, installed, tmp_path):
    site, environment = installed
    write_scene(small_scene(), tmp_path / "garden.ply")
    own = {f"XDG_{each}_HOME": str(tmp_path / each.lower()) for each in ("CONFIG", "STATE")}
    program, *options = shlex.split(command)
    until = time.monotonic() + _LONGEST_S
    with subprocess.Popen([site / "bin" / program, *options], cwd=tmp_path, env=environment | own) as window:
        try:
            while (found := colors_on_screen()) < PICTURE_COLORS:
                assert time.monotonic() < until, f"{found} colors after {_LONGEST_S:g} s"
                with pytest.raises(subprocess.TimeoutExpired):  # else it has ended
                    window.wait(0.5)
        finally:
            window.terminate()
