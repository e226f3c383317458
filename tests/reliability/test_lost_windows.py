"""Windows whose graphics card is lost: the work is kept, and a new window goes on with it by itself."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gsrain_engine.editor.autosave import autosave_folder
from gsrain_engine.scene.formats.scene_files import write_scene
from small_scene import small_scene
from window_driver import testing  # noqa: F401  skips where no window can open

PROGRAM = Path(__file__).with_name("lost_window.py")
RESTARTED = "The graphics driver has restarted, and so has this window"


@pytest.fixture
def scene(tmp_path):
    write_scene(small_scene(), tmp_path / "road")
    return tmp_path / "road"


def run_window(scene, losses, *how, restarts=0):
    """Run the program; returns its exit code, what its windows showed, and what it said on stderr."""
    own = {"XDG_STATE_HOME": str(scene.parent / "state"), "XDG_CONFIG_HOME": str(scene.parent / "config")}
    environment = os.environ | own | ({"GSRAIN_RESTARTS": str(restarts)} if restarts else {})
    command = [sys.executable, PROGRAM, scene, str(losses), *how]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=900)
    return ended.returncode, ended.stdout.splitlines(), ended.stderr


def test_another_window_goes_on_with_the_work(scene):
    code, shown, said = run_window(scene, 1)
    before, after = shown
    assert before == "0: small at 0.0 mm/h, changed: False, tells of resets: True, says: None, asks: None"
    assert after.startswith("1: small at 77.0 mm/h, changed: True, tells of resets: True, says: " + RESTARTED)
    assert "still to be saved" in after and after.endswith(" asks: None")
    assert "What was changed is kept for the next window.\nThe graphics card was lost; the window begins again." in said
    assert "Traceback" not in said
    assert code == 0
    assert not autosave_folder(scene).exists()  # the second window was told not to save
    assert (scene.parent / "config" / "gsrain" / "window.ini").is_file()  # and both had the same layout


def test_without_changes_it_opens_the_scene_again(scene):
    code, shown, said = run_window(scene, 1, "unchanged")
    assert shown[1].startswith("1: small at 0.0 mm/h, changed: False, tells of resets: True, says: " + RESTARTED)
    assert "still to be saved" not in shown[1] and "What was changed" not in said
    assert (code, len(shown)) == (0, 2)


def test_it_does_not_begin_again_for_ever(scene):
    code, shown, said = run_window(scene, 9, restarts=3)
    assert (code, len(shown)) == (2, 1)
    assert "What was changed is kept for the next window." in said
    assert said.endswith("gsrain: the graphics card was lost 4 times in a row: its driver does not come back\n")
    assert (autosave_folder(scene) / "autosave.json").is_file()


def test_a_driver_that_fails_in_a_frame_costs_no_work(scene):
    code, shown, said = run_window(scene, 9, "raise")
    assert (code, len(shown)) == (2, 1)
    assert "What was changed is kept for the next window." in said
    assert said.endswith("gsrain: the graphics driver has failed: cannot create texture\n")
    assert (autosave_folder(scene) / "autosave.json").is_file()
