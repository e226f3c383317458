"""One person's afternoon: open, scale, cut, import, place, rain, keys, record, save; kill -9; come back and recover."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import glfw
import pytest

import window_driver  # noqa: F401  skips where there is no display
from app.main import run
from gsrain_engine.scene.formats.scene_files import write_scene
from training.small_street import small_street

SCRIPT = Path(__file__).resolve().parent.parent / "whole_session.py"


def sitting(name, folder, *arguments):
    """Begin a sitting in a process of its own, with settings and unsaved work of its own."""
    places = {"XDG_STATE_HOME": str(folder / "state"), "XDG_CONFIG_HOME": str(folder / "config")}
    return subprocess.Popen(
        [sys.executable, str(SCRIPT), name, str(folder), *map(str, arguments)],
        env=os.environ | places | {"PYTHONPATH": os.pathsep.join([str(SCRIPT.parent), str(SCRIPT.parent.parent)])},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def heard(process, until=None):
    """Output of a editor, first word by the rest, up to a line or its end."""
    said, everything = {}, []
    for line in process.stdout:
        everything.append(line)
        word, _, rest = line.strip().partition(" ")
        said[word] = rest
        if line.strip() == until:
            return said
    assert until is None and process.wait() == 0, "".join(everything[-60:])
    return said


def test_an_afternoon_with_a_crash_in_it(tmp_path, test_data):
    glfw.init()  # a client of the X server that stays: it starts over when its last one leaves
    street = small_street()
    write_scene(street, tmp_path / "street.ply")
    imported = sum(len(part.gaussians) for part in street.parts())
    with sitting("first", tmp_path, test_data / "scenes" / "plant.splat") as person:
        try:
            said = heard(person, "kill me")
        finally:
            os.kill(person.pid, signal.SIGKILL)
    assert said["opened"] == "113648"
    assert float(said["scale"]) != 1
    selected, deleted = map(int, said["deleted"].split())
    assert selected == deleted > 1000
    assert said["undone"] == "0"
    assert int(said["redone"]) == deleted
    assert float(said["placed"].split()[0]) > 0.1
    assert said["placed"].endswith("Move street")
    assert said["keys"] == "[0.0, 1.5, 3.0, 5.0]"
    assert float(said["scrubbed"]) == pytest.approx(2.0, abs=0.1)
    assert said["recorded"] == "finished None"
    assert said["saved"] == "False"
    assert float(said["autosaved"]) < 30

    with sitting("second", tmp_path) as person:
        said = heard(person)
    rain, count, keys = said["recovered"].split()
    assert (float(rain), int(keys)) == (12, 4)
    assert int(count) == 113_648 - deleted + imported

    clip = tmp_path / "command_line.mp4"
    assert run(["render", str(tmp_path / "project"), "-o", str(clip), "--size", "192x128", "--fps", "10"]) == 0
    assert clip.read_bytes() == (tmp_path / "window.mp4").read_bytes()
