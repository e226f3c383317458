"""The window's layout file: one a window while it is open, whole and shared afterwards."""

import os
import subprocess
import sys

import pytest

from gsrain_engine.editor.preferences import config_folder, state_folder
from ui.window import own_layout


@pytest.fixture(autouse=True)
def own_folders(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


def test_the_next_window_gets_what_the_last_one_has_left():
    with own_layout() as layout:
        assert not layout.exists()
        layout.write_text("first")
    assert (config_folder() / "window.ini").read_text() == "first"
    with own_layout() as layout:
        assert layout.read_text() == "first"
        layout.write_text("second")
        assert (config_folder() / "window.ini").read_text() == "first"
    assert (config_folder() / "window.ini").read_text() == "second"
    assert not layout.exists()


def test_what_killed_windows_have_left_is_removed_and_what_living_ones_use_is_not():
    process = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True)
    dead = state_folder() / "layouts" / f"{int(process.stdout)}.ini"
    alive = dead.with_name(f"{os.getppid()}.ini")
    dead.parent.mkdir(parents=True)
    dead.write_text("old")
    alive.write_text("in use")
    with own_layout():
        assert not dead.exists()
        assert alive.read_text() == "in use"


def test_a_disk_that_takes_no_file_costs_the_layout_alone(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("no folder can be made in it")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    with own_layout() as layout:
        assert layout is None  # a path would end the window, which makes its folder
    assert not (tmp_path / "config").exists()
