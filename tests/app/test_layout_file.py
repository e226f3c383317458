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


def test_each_window_gets_the_layout_of_the_last_one_and_removes_those_of_killed_ones():
    with own_layout() as layout:
        assert not layout.exists()
        layout.write_text("first")
    process = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True)
    dead = state_folder() / "layouts" / f"{int(process.stdout)}.ini"
    alive = dead.with_name(f"{os.getppid()}.ini")
    dead.write_text("old")
    alive.write_text("in use")
    with own_layout() as layout:
        assert layout.read_text() == "first" and alive.read_text() == "in use"
        assert not dead.exists()
        layout.write_text("second")
        assert (config_folder() / "window.ini").read_text() == "first"
    assert (config_folder() / "window.ini").read_text() == "second"
    assert not layout.exists()


def test_a_disk_that_takes_no_file_costs_the_layout_alone(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("no folder can be made in it")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    with own_layout() as layout:
        assert layout is None  # a path would end the window, which makes its folder
    assert not (tmp_path / "config").exists()
