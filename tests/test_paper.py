"""The page about the paper: its files exist, and its commands run in small where they need no data of others."""

import re
import shlex

import pytest

from app.main import run
from gsrain_engine.scene.formats.scene_files import write_scene
from repository import REPOSITORY
from small_scene import small_scene

PAGE = (REPOSITORY / "docs" / "paper.md").read_text()
COMMANDS = list(dict.fromkeys(re.findall(r"(?:`|    )(gsrain [^`\n]+)", PAGE)))

IN_SMALL = {
    "gsrain disdrometer --preset paper --seconds 10": "--area 0.01",
    "gsrain disdrometer --preset 12.0 --drop-density table --seconds 10": "--area 0.01",
    "gsrain render street --preset paper -o paper.png": "--size 96x64 --backend cpu",
    "gsrain render SCENE --sheet 0,1.2,8.5,12 --wet -o sheet.png": "--size 96x64 --backend cpu",
    "gsrain render SCENE --preset paper --wet -o complete.png": "--size 96x64 --backend cpu",
    "gsrain render SCENE --wet": "--size 96x64 --backend cpu -o wet.png",
    "gsrain drive cut-in --rain 0,1.2,8.5,12 -o cut_in": "--agent oracle-idm --duration 1 --no-video",
    "gsrain sweep paper -o paper_drives": "--shard 1/160 --workers 0",
}
"""Commands that need nothing, and what makes each take seconds."""
NEEDS_DATA = (
    "calibrate", "train-transfer", "evaluate transfers", "evaluate consistency", "evaluate detection", "transfer",
    "recolor", "reconstruct", "sweep paper_hugsim", "drive scene-0383", "drive cut-in --scene", "export-rain",
)  # fmt: skip
"""Beginnings of commands that need data, weights or a driver; their own tests run them on stand-ins."""


def test_every_command_is_run_here_or_needs_data():
    needing = [each for each in COMMANDS if each.removeprefix("gsrain ").startswith(NEEDS_DATA)]
    assert set(COMMANDS) - set(needing) - {"gsrain doctor"} == set(IN_SMALL)


@pytest.mark.parametrize("path", sorted(set(re.findall(r"`((?:gsrain_engine|shaders)/[^`]*)`", PAGE))))
def test_every_file_of_the_page_exists(path):
    assert (REPOSITORY / path).exists()


@pytest.mark.parametrize("command", IN_SMALL)
def test_commands_without_data_run(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_scene(small_scene(), tmp_path / "SCENE")
    assert run([*shlex.split(command)[1:], *shlex.split(IN_SMALL[command])]) == 0
    for output in re.findall(r"-o (\S+)", f"{command} {IN_SMALL[command]}"):
        assert (tmp_path / output).exists()
