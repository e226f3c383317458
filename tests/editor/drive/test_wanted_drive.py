"""Settings of a drive before it starts."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.editor.drive import CameraMosaic, DriveSetup, mosaic_rows
from gsrain_engine.editor.jobs.drive import DriveSettings
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.simulation.scenario_io import load_scenario

from .driven import driven


def test_a_changed_scenario_is_saved_and_opened_again(tmp_path):
    wanted = DriveSetup()
    assert (wanted.source, wanted.is_changed) == ("stationary-lead", False)
    user = msgspec.structs.replace(wanted.scenario.road_users[0], ahead_m=25.0)
    wanted.change_user(0, user)
    wanted.change(msgspec.structs.replace(wanted.scenario, speed_m_s=12.5))
    assert wanted.is_changed
    wanted.save(tmp_path / "nearer")
    assert (wanted.source, wanted.is_changed) == (str(tmp_path / "nearer.yaml"), False)
    assert load_scenario(tmp_path / "nearer.yaml") == wanted.scenario
    wanted.load("stationary-lead")
    assert wanted.scenario.speed_m_s == 10.0
    wanted.load(tmp_path / "nearer.yaml")
    assert (wanted.scenario.speed_m_s, wanted.scenario.road_users[0].ahead_m) == (12.5, 25.0)


def test_what_is_out_of_bounds_is_not_taken():
    wanted = DriveSetup()
    before = wanted.scenario
    wanted.change(msgspec.structs.replace(before, speed_m_s=-1.0))
    assert wanted.scenario is before
    assert "speed_m_s" in wanted.problem
    wanted.load("no-such-scenario")
    assert "no-such-scenario" in wanted.problem
    assert wanted.scenario is before


def test_a_missing_detector_is_told_before_anything_starts(tmp_path):
    wanted = DriveSetup()
    assert wanted.why_not is None
    wanted.settings = msgspec.structs.replace(wanted.settings, detector=tmp_path / "none.onnx")
    assert "none.onnx" in wanted.why_not


def test_rains_of_a_drive():
    present = RainSettings(intensity_mm_h=3.0, exposure_s=0.01)
    settings = DriveSettings(agent="x")
    assert settings.rains(present) == (present,)
    one = msgspec.structs.replace(settings, rain="one intensity", intensity_mm_h=7.0)
    assert [(each.intensity_mm_h, each.exposure_s) for each in one.rains(present)] == [(7.0, 0.01)]
    four = msgspec.structs.replace(settings, rain="paper's four")
    assert [each.intensity_mm_h for each in four.rains(present)] == [0.0, 1.2, 8.5, 12.0]


def test_the_mosaic_shows_the_rig_as_one_would_look_for_it():
    scene = driven()[0]
    (front,) = scene.rigs["one"]
    turned = {}
    for name, degrees in (("left", 55), ("right", -55), ("back", 180), ("back left", 110), ("back right", -110)):
        pose = front.camera_to_ego.copy()
        pose[:3, :3] = rotation(degrees) @ pose[:3, :3]
        turned[name] = replace(front, name=name, camera_to_ego=pose)
    rows = mosaic_rows([front, *(turned[name] for name in ("back right", "right", "back", "left", "back left"))])
    names = [[each.name for each in row] for row in rows]
    assert names == [["left", "FRONT", "right"], ["back left", "back", "back right"]]
    mosaic = CameraMosaic(rig="gone")
    assert mosaic.cameras(scene) == (front,)
    mosaic.want(251.0)
    assert (mosaic.is_requested, mosaic.width_px) == (True, 256)


def rotation(degrees):
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]])


@pytest.mark.parametrize("name", DriveSetup().scenario_names)
def test_every_shipped_scenario_comes_back_from_a_file(name, tmp_path):
    wanted = DriveSetup()
    wanted.load(name)
    before = wanted.scenario
    wanted.save(tmp_path / "copy.yaml")
    assert load_scenario(tmp_path / "copy.yaml") == before
