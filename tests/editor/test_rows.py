"""Timeline rows below the camera's keyframes."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.timeline import ego_speed_km_h, presence, track_rows, weather_row
from gsrain_engine.rain.keyframes import RainKeyframe, RainKeyframes
from gsrain_engine.scene.scene import PoseTrack
from small_scene import small_scene


def test_presence_and_speed_of_what_drives():
    scene = replace(small_scene(), metres_per_unit=0.25)
    track = scene.ego
    assert track_rows(scene)[0].spans_s == [(0, 5)]
    holes = PoseTrack(track.times, track.positions, track.quaternions_wxyz, np.array([1, 0, 0, 1, 1, 0], bool))
    assert presence(holes) == [(0, 1), (3, 5)]
    assert ego_speed_km_h(scene, 2.5) == pytest.approx(3.6 * 2.0 * 0.25)
    assert ego_speed_km_h(scene, 5.0) == pytest.approx(3.6 * 2.0 * 0.25)
    assert ego_speed_km_h(scene, 5.1) is None
    assert ego_speed_km_h(replace(scene, ego=holes), 2.0) is None


def test_many_weather_keys_are_thinned():
    keys = tuple(RainKeyframe(time_s=float(t), intensity_mm_h=1.0) for t in range(1000))
    row = weather_row(RainKeyframes(keys=keys), 100.0, 500.0, 50)
    assert 40 <= len(row.keys_s) <= 50
    assert min(row.keys_s) >= 100
    assert max(row.keys_s) <= 500
