"""Easing of keyframes: shares and rates, of camera paths and of the rain, and their files."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from gsrain_engine.editor.edits.rain_keyframes import copy_keyframe, move_keyframe, set_keyframe_easing
from gsrain_engine.rain.keyframes import RainKeyframes, read_keyframes, write_keyframes
from gsrain_engine.rain.settings import RainSettings
from gsrain_engine.rain.simulation import RainSimulation
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.camera_path_edit import (
    copy_keyframe_to,
    reverse_path_time,
    set_key_easing,
    without_keyframe,
)
from gsrain_engine.scene.camera_path_edit import (
    move_keyframe as move_camera_keyframe,
)
from gsrain_engine.scene.camera_path_io import read_camera_path, write_camera_path
from gsrain_engine.scene.easing import KEY_EASINGS, eased_share
from gsrain_engine.scene.formats.scene_json import path_of, path_record
from gsrain_engine.scene.lamps import Lamp
from gsrain_engine.scene.scene import Scene

MIDDLE = {"linear": 0.5, "smooth": 0.5, "ease in": 0.25, "ease out": 0.75, "hold": 0.0}
"""Progress of each easing at half the time."""


def straight_path() -> CameraPath:
    def camera(x: float) -> Camera:
        pose = np.eye(4)
        pose[0, 3] = x
        return Camera.from_fov(64, 48, 60.0, np.linalg.inv(pose))

    return replace(CameraPath.through([0.0, 2.0, 4.0], [camera(0), camera(4), camera(8)]), interpolation="linear")


@pytest.mark.parametrize("easing", KEY_EASINGS)
def test_an_easing_goes_from_0_to_1_with_the_rate_of_its_slope(easing):
    u = np.linspace(0, 1, 2001)
    share, rate = eased_share(easing, u)
    assert (share[0], share[-1], share[1000]) == (0, 1, MIDDLE[easing])
    if easing != "hold":
        np.testing.assert_allclose(np.gradient(share, u)[1:-1], rate[1:-1], atol=1e-3)


@pytest.mark.parametrize("easing", KEY_EASINGS)
def test_camera_and_rain_follow_the_easing_after_a_keyframe_only(easing):
    path = set_key_easing(straight_path(), 0, easing)
    assert path.places(np.array([1.0, 2.0, 3.0]))[:, 0] == pytest.approx([4 * MIDDLE[easing], 4, 6])
    rain = RainKeyframes().with_key(0.0, intensity_mm_h=2.0).with_key(2.0, intensity_mm_h=10.0)
    rain = set_keyframe_easing(rain.with_key(4.0, intensity_mm_h=0.0), "intensity_mm_h", 0, easing)
    curve = rain.curves["intensity_mm_h"]
    found = [float(curve.at(t)[0]) for t in (0.0, 1.0, 2.0, 3.0)]
    assert found == pytest.approx([2, 2 + 8 * MIDDLE[easing], 10, 5], abs=0.05)


def test_edits_take_the_easing_along_and_files_restore_it(tmp_path):
    path = set_key_easing(set_key_easing(straight_path(), 0, "ease in"), 1, "hold")
    assert copy_keyframe_to(path, 1, 3.0).path.key_easings == ("ease in", "hold", "hold", None)
    assert move_camera_keyframe(path, 0, 5.0).path.key_easings == ("hold", None, "ease in")
    assert without_keyframe(path, 0).key_easings == ("hold", None)
    assert reverse_path_time(path).key_easings == ("hold", "ease out", None)
    write_camera_path(tmp_path / "path.json", path)
    assert read_camera_path(tmp_path / "path.json").key_easings == path.key_easings
    assert path_of(path_record(path), "").key_easings == path.key_easings
    plain = msgspec.json.encode(path_record(straight_path()))
    assert b"easing" not in plain.split(b'"exposure_s"')[0]  # a path without is written as before

    rain = RainKeyframes().with_key(0.0, wetness=0.2, lamp_gain=0.0).with_key(6.0, wetness=1.0, lamp_gain=2.0)
    rain = set_keyframe_easing(rain, "lamp_gain", 0, "hold")
    moved = copy_keyframe(move_keyframe(rain, "lamp_gain", 0, 2.0), "lamp_gain", 0, 4.0)
    assert [key.easing for key in moved.keys] == [{}, {"lamp_gain": "hold"}, {"lamp_gain": "hold"}, {}]
    write_keyframes(tmp_path / "rain.yaml", moved)
    assert read_keyframes(tmp_path / "rain.yaml") == moved
    (tmp_path / "rain.yaml").write_text("keys:\n- {time_s: 0, lamp_gain: 11}\n")
    with pytest.raises(ValueError, match=r"rain\.yaml: 11 must be at most 10 .*lamp_gain"):
        read_keyframes(tmp_path / "rain.yaml")


def test_wetness_and_lamps_have_tracks_of_their_own():
    tracks = RainKeyframes().with_key(0.0, wetness=0.0, lamp_gain=0.0).with_key(4.0, wetness=1.0, lamp_gain=2.0)
    simulation = RainSimulation.start(RainSettings(intensity_mm_h=8.5), weather=tracks)
    assert [simulation.wetness_at(t) for t in (0.0, 1.0, 9.0)] == [0.0, 0.25, 1.0]
    assert simulation.overcast_at(0.0) == 1.0 and not simulation.is_never_overcast  # dry still, below clouds
    scene = Scene("lamps", lamps=(Lamp(position=(0, 0, 5), intensity_m2=3.0),))
    assert [simulation.lamps_of(scene, t)[0].intensity_m2 for t in (0.0, 2.0, 4.0)] == [0.0, 3.0, 6.0]
