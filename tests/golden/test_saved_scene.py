"""A scene folder of version 4 of scene.json holds what it held, and so do the settings that tests.golden uses."""

import json
import shutil
from collections import Counter
from pathlib import Path

import msgspec
import numpy as np
import pytest
import yaml

from editor.files.open_document import settle
from gsrain_engine.disdrometer.tables import load_columns
from gsrain_engine.editor.editor import Editor
from gsrain_engine.evaluation.lidar.sensor import LidarSensor
from gsrain_engine.rain.keyframes import keyframes_of, rain_of
from gsrain_engine.rain.settings import HAZE_REGION, RainSettings, load_preset, wind_on_compass
from gsrain_engine.safe_io.errors import convert_checked
from gsrain_engine.safe_io.text_files import yaml_values
from gsrain_engine.scene.formats.scene_files import read_scene
from gsrain_engine.simulation.scenario_io import load_scenario
from gsrain_engine.sweep.settings import load_sweep

SAVED = Path(__file__).parent / "saved"


@pytest.fixture
def saved(tmp_path):
    """A copy of all files."""
    return shutil.copytree(SAVED, tmp_path / "saved", ignore=shutil.ignore_patterns("__pycache__"))


@pytest.fixture
def editor():
    opened = Editor()
    yield opened
    opened.close()


def test_members_of_the_scene_folder():
    scene = read_scene(SAVED / "crossing")
    members = {each.key: each for each in scene.members}
    assert {key: (len(each.gaussians), each.gaussians.sh.shape[1]) for key, each in members.items()} == {
        "layers/road": (520, 1), "layers/wall": (162, 4), "layers/hedge": (180, 4), "layers/roof": (49, 1),
        "layers/sky": (96, 1), "actors/lead": (64, 1),
    }  # fmt: skip
    road, wall, hedge, roof, sky = scene.layers
    assert (road.wet_sh is not None, wall.wet_sh, scene.actors[0].wet_sh is not None) == (True, None, True)
    assert (hedge.opacity, hedge.locked, roof.visible, sky.kind) == (0.8, True, False, "sky")
    assert hedge.to_scene[2].tolist() == [0, 0, 1, 0.25]
    grading = wall.grading
    assert (grading.exposure_ev, grading.temperature, grading.tint) == (0.25, 0.1, -0.05)
    assert (grading.contrast, grading.saturation) == (1.1, 0.9)
    assert np.array_equal(road.marks.selected.flags, road.gaussians.means[:, 0] < 4)
    assert np.array_equal(road.marks.hidden.flags, road.gaussians.means[:, 0] > 50)
    assert np.array_equal(wall.marks.deleted.flags, wall.gaussians.means[:, 1] > 8.5)
    assert (road.marks.selected.size, road.marks.hidden.size, wall.marks.deleted.size) == (78, 13, 9)
    assert {name: {key: mask.size for key, mask in masks.items()} for name, masks in scene.selections.items()} == {
        "near": {"layers/road": 78}, "top": {"layers/wall": 54},
    }  # fmt: skip


def test_what_belongs_to_the_whole_scene_folder():
    scene = read_scene(SAVED / "crossing")
    assert (scene.name, scene.ground_m, scene.up, scene.metres_per_unit) == ("crossing", 0.0, (0.0, 0.0, 1.0), 1.0)
    (actor,) = scene.actors
    assert (actor.id, actor.class_name, actor.size_lwh) == ("lead", "car", (4.2, 1.8, 1.5))
    assert actor.track.positions[1].tolist() == [15.5, 1.2, 0.0]
    assert actor.track.valid.tolist() == [True, True, True, False]
    assert scene.ego.positions[-1].tolist() == [30.0, 0.5, 1.5]
    assert [(each.name, each.width, each.exposure_s) for each in scene.rigs["pair"]] == [
        ("FRONT", 96, 0.004), ("LEFT", 64, 0.002),
    ]  # fmt: skip
    path = scene.path
    assert (path.interpolation, path.easing, path.loop, path.exposure_s) == ("linear", "in and out", True, 0.008)
    assert path.times_s.tolist() == [0.0, 1.0, 2.5, 4.0]
    assert path.vertical_fov_deg.tolist() == [50.0, 48.0, 52.0, 50.0]
    rain = rain_of(scene)
    assert rain == msgspec.structs.replace(
        RainSettings(), intensity_mm_h=7.5, seed=3, gust_m_s=1.5, wind_m_s=(2.0, -1.0), exposure_s=0.01, roofs=True,
        haze_gain=1.25, drying_s=120.0, drop_color=(0.7, 0.75, 0.8), max_copies=3, haze_region=HAZE_REGION,
        aperture_mm=0.0, focus_distance_m=10.0,
    )  # fmt: skip
    weather = keyframes_of(scene)
    assert (weather.between, weather.key_times["intensity_mm_h"].tolist()) == ("smooth", [0.0, 1.5, 4.0])
    assert weather.rain_at(rain, 1.5).wind_vector_m_s == (3.0, 0.5)
    assert weather.rain_at(rain, 4.0).exposure_s == 0.02


def test_the_window_opens_the_scene_folder_as_it_was_left(saved, editor):
    editor.files.open(str(saved / "crossing"))
    settle(editor)
    assert editor.status.problem is None and editor.status.question is None
    assert (editor.document.rain.intensity_mm_h, len(editor.document.keyframes.keys)) == (7.5, 3)
    assert editor.viewport.navigation.position.tolist() == [-2.0, 0.5, 2.25]
    assert (editor.viewport.navigation.heading, editor.playback.clock.time_s) == (0.05, 1.25)
    assert (editor.viewport.options.gain_ev, editor.viewport.options.background) == (0.5, (0.1, 0.2, 0.3))


@pytest.mark.parametrize(
    ("name", "load"),
    [
        ("preset", load_preset),
        ("scenario", load_scenario),
        ("lidar", lambda path: convert_checked(yaml_values(Path(path).read_bytes()), LidarSensor)),
        ("columns", load_columns),
        ("../sweep/drives", load_sweep),
        ("../sweep/frames", load_sweep),
    ],
)
def test_settings_keep_all_their_values(name, load, monkeypatch):
    path = SAVED / "settings" / f"{name}.yaml"
    monkeypatch.chdir(path.parent)
    written = yaml.safe_load(path.read_text())
    for each in (written, written.get("rain", {})):
        if "wind_m_s" in each:  # as it is written today
            speed_m_s, from_deg = wind_on_compass(*each.pop("wind_m_s"))
            each |= {"wind_speed_m_s": speed_m_s} | ({"wind_from_deg": from_deg} if speed_m_s else {})
    assert _leaves(written) <= _leaves(msgspec.to_builtins(load(path.name), enc_hook=str))


def _leaves(values):
    """Count what is neither a mapping nor a list."""
    if isinstance(values, dict | list | tuple):
        inner = values.values() if isinstance(values, dict) else values
        return sum(map(_leaves, inner), Counter())
    return Counter([json.dumps(float(values) if isinstance(values, int) and not isinstance(values, bool) else values)])
