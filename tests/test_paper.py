"""The page about the paper: its files exist, and its commands run in small where they need no data of others."""

import re
import shlex

import pytest

from app.main import run
from gsrain_engine.appearance import dsine_checkout
from gsrain_engine.rain.calibration import load_calibration
from gsrain_engine.safe_io.errors import not_found
from gsrain_engine.scene.formats.scene_files import write_scene
from gsrain_engine.simulation.metrics.comfort import PAPER
from gsrain_engine.simulation.scenario_io import load_scenario
from repository import REPOSITORY
from small_scene import small_scene

PAGE = (REPOSITORY / "docs" / "paper.md").read_text()
COMMANDS = list(dict.fromkeys(re.findall(r"(?:`|    )(gsrain [^`\n]+)", PAGE)))

_SMALL_STILL = "--size 96x64 --backend cpu"
IN_SMALL = {
    "gsrain disdrometer --preset paper --seconds 60": "--area 0.01",
    "gsrain disdrometer --preset 1.2 --drop-density table": "--area 0.01",
    "gsrain disdrometer --preset 8.5 --drop-density table": "--area 0.01",
    "gsrain disdrometer --preset 12.0 --drop-density table": "--area 0.01",
    "gsrain render street --preset paper -o paper.png": _SMALL_STILL,
    "gsrain render street --rain 12 --no-haze -o near.png": _SMALL_STILL,
    "gsrain render street --rain 12 --no-streaks -o far.png": _SMALL_STILL,
    "gsrain render SCENE --sheet 0,8.5 --wet -o complete.png": _SMALL_STILL,
    "gsrain render SCENE --preset paper --wet -o complete_paper.png": _SMALL_STILL,
    "gsrain render SCENE --sheet 1.2,8.5,12 --wet -o sheet.png": _SMALL_STILL,
    "gsrain render SCENE --wet": f"{_SMALL_STILL} -o wet.png",
    "gsrain drive cut-in --rain 0 --agent oracle-idm --video -o cut_in_scene": "--duration 0.5 --fps 2 --backend cpu",
    "gsrain drive stationary-lead --rain 0 --agent oracle-idm --video -o stationary_scene":
        "--duration 0.5 --fps 2 --backend cpu",
    "gsrain drive cut-in --rain 0,1.2,8.5,12 --agent oracle-idm -o cut_in": "--duration 1",
    "gsrain drive stationary-lead --rain 0,1.2,8.5,12 --agent oracle-idm -o stationary": "--duration 1",
    "gsrain sweep paper -o paper_drives": "--shard 1/160 --workers 0",
}  # fmt: skip
"""Commands that need nothing, and what makes each take seconds."""
NEEDS_DATA = (
    "calibrate", "train-transfer", "evaluate transfers", "evaluate consistency", "evaluate detection", "transfer",
    "recolor", "reconstruct", "sweep paper_hugsim", "drive scene-0383", "drive cut-in --scene", "export-rain",
    "drive cut-in --rain 0,1.2,8.5,12 --agent camera-idm", "render wet_scene",
)  # fmt: skip
"""Beginnings of commands that need data, weights or a driver; their own tests run them on stand-ins."""


def test_every_command_is_run_here_or_needs_data():
    needing = [each for each in COMMANDS if each.removeprefix("gsrain ").startswith(NEEDS_DATA)]
    assert set(COMMANDS) - set(needing) - {"gsrain doctor"} == set(IN_SMALL)


def test_no_command_writes_over_the_output_of_another_or_over_data():
    compared = [each for each in COMMANDS if "evaluate transfers" in each]  # of which a second one goes on in a folder
    outputs = [name for each in COMMANDS if each not in compared for name in re.findall(r" -o (\S+)", each)]
    outputs += {name for each in compared for name in re.findall(r" -o (\S+)", each)}
    assert len(outputs) > 20 and sorted(set(outputs)) == sorted(outputs)
    data = {
        name.split("/")[0]
        for row in PAGE.split("## The data")[1].splitlines()
        for name in re.findall(r"`([^`]*)`", row)
    }
    assert {"rainy", "bdd100k", "scene-0383"} <= data and not data - {"table", "waymo_table"} & set(outputs)


def test_the_page_names_the_places_where_dsine_is_looked_for(tmp_path, monkeypatch):
    for variable in (dsine_checkout.WEIGHTS_PLACE, dsine_checkout.CHECKOUT_PLACE):
        monkeypatch.delenv(variable, raising=False)
        assert f"`{variable}`" in PAGE
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    for find in (dsine_checkout.find_dsine_weights, dsine_checkout.find_dsine_checkout):
        (error,) = not_found(find)
        place = re.search(rf" at {re.escape(str(tmp_path))}/(\S+):", error)
        assert place is not None and f"`~/.local/share/{place[1]}" in PAGE
    assert not [each for each in COMMANDS if "--normals-weights" in each or "--normals-checkout" in each]


def test_every_table_and_figure_has_its_row():
    rows = "\n".join(line for line in PAGE.splitlines() if line.startswith("| "))
    rows = rows.replace("Fig. 13 and 14", "Fig. 13, Fig. 14").replace("Fig. 9 and 10", "Fig. 9, Fig. 10")
    rows = rows.replace("Tables VII, VIII", "Table VII, Table VIII")
    assert {int(number) for number in re.findall(r"Fig\. (\d+)", rows)} == set(range(1, 18))
    tables = set(re.findall(r"Table ([IV]+)\b", rows))
    assert tables == {"I", "II", "III", "IV", "V", "VI", "VII", "VIII"}


def test_scenarios_thresholds_and_sizes_are_those_of_the_tables():
    """Tables III to VI of the paper."""
    for name, ego_m_s, ahead_m, other_m_s in (("cut-in", 5, 10, 5), ("stationary-lead", 10, 40, 0)):
        scenario = load_scenario(name)
        (lead,) = scenario.road_users
        assert (scenario.speed_m_s, lead.ahead_m, lead.speed_m_s) == (ego_m_s, ahead_m, other_m_s)
    assert PAPER[:6] == (-4.05, 2.40, 8.37, 4.89, 0.95, 1.93)
    rows = load_calibration("published").rows
    assert [(row.intensity_mm_h, row.density_m3, row.shape, row.scale_mm) for row in rows] == [
        (1.2, 271, 9.705, 0.074), (8.5, 1190, 7.132, 0.114), (12.0, 1710, 10.466, 0.085)
    ]  # fmt: skip


@pytest.mark.parametrize("path", sorted(set(re.findall(r"`((?:gsrain_engine|shaders|sample_configs)/[^`]*)`", PAGE))))
def test_every_file_of_the_page_exists(path):
    assert (REPOSITORY / path).exists()


@pytest.mark.parametrize("command", IN_SMALL)
def test_commands_without_data_run(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_scene(small_scene(), tmp_path / "SCENE")
    assert run([*shlex.split(command)[1:], *shlex.split(IN_SMALL[command])]) == 0
    for output in re.findall(r"-o (\S+)", f"{command} {IN_SMALL[command]}"):
        assert (tmp_path / output).exists()
