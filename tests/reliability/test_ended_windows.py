"""Windows that are ended from outside, as by a machine that goes down: unsaved changes are kept for the next start."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gsrain_engine.editor.autosave import autosave_folder
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from small_scene import small_scene
from window_driver import testing  # noqa: F401  skips where no window can open

TESTS = Path(__file__).parents[1]
PROGRAM = """
import os, signal, sys
from ui import window
from app.main import run
from editor.files.open_document import delete_every_third

def go_on(self, context):
    before(self, context)
    editor = self._editor
    if self.workspace is not None and editor.files.home is not None and not editor.files.has_changes:
        delete_every_third(editor)
        if sys.argv[2] == "close":
            self.ask_to_close()
            os.kill(os.getpid(), signal.SIGKILL) if editor.files.recovery.autosaved_path else None
        os.kill(os.getpid(), getattr(signal, sys.argv[2]))

before, window.MainWindow.advance = window.MainWindow.advance, go_on
sys.exit(run([sys.argv[1], "--backend", "cpu"]))
"""


@pytest.mark.parametrize("how", ["SIGTERM", "SIGHUP", "close"])
def test_changes_are_kept_when_nobody_can_be_asked(tmp_path, how):
    write_scene(small_scene(), tmp_path / "road")
    own = {"XDG_STATE_HOME": str(tmp_path / "state"), "XDG_CONFIG_HOME": str(tmp_path / "config")}
    own["PYTHONPATH"] = os.pathsep.join([str(TESTS), str(TESTS.parent)])
    command = [sys.executable, "-c", PROGRAM, tmp_path / "road", how]
    ended = subprocess.run(command, env=os.environ | own, capture_output=True, text=True, check=False, timeout=900)
    assert "Traceback" not in ended.stderr
    if how == "close":  # asked, and then cut off by the end of the display
        assert ended.returncode == -9
    else:
        assert (ended.returncode, ended.stderr.splitlines()[-1]) == (
            2, f"gsrain: the window was ended from outside ({how})")  # fmt: skip
    kept = read_scene(autosave_folder(tmp_path / "road") / "scene")
    assert kept.members[0].marks.deleted is not None
