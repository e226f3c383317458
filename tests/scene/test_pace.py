"""Paths of photos without times: as fast as one walks, or as is asked for."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.editor.edits.level import set_length
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.camera_path_edit import (
    WALKING_M_S,
    PathSpeed,
    move_keyframe,
    place_keyframe_at,
    stretch_path_time,
    with_constant_speed,
    with_keyframe,
)
from gsrain_engine.scene.camera_path_io import read_camera_path
from gsrain_engine.scene.formats.scene_files import read_scene, write_scene
from small_scene import small_scene

AHEAD = np.array([[0.5, -0.5, 0.5, -0.5]])


def photos(*places: float) -> CameraPath:
    """Photos from places along x, a second each as if that were known."""
    positions = np.array([[x, 0.0, 2.0] for x in places])
    return CameraPath(
        np.arange(float(len(places))), positions, AHEAD.repeat(len(places), 0), np.full(len(places), 50.0)
    )


def test_keys_are_passed_at_the_speed() -> None:
    path = with_constant_speed(photos(0, 1, 5, 6), 2.0)
    assert path.times_s.tolist() == [0, 0.5, 2.5, 3.0] and not path.is_timed
    assert PathSpeed.of(path).mean_km_h == pytest.approx(7.2, rel=0.02)
    assert with_constant_speed(path, 2.0, is_timed=True).is_timed
    assert with_constant_speed(photos(3), 2.0).times_s.tolist() == [0]


def test_photos_from_one_place_take_time_to_turn() -> None:
    path = photos(1, 1, 1)
    turned = replace(
        path, quaternions_wxyz=np.array([[1.0, 0, 0, 0], [np.sqrt(0.5), 0, np.sqrt(0.5), 0], [0, 0, 1, 0]])
    )
    assert np.diff(with_constant_speed(turned, 1.4).times_s) == pytest.approx([1.0, 1.0])
    assert (np.diff(with_constant_speed(path, 1.4).times_s) > 0).all()


@pytest.mark.parametrize("speed", [0.0, -1.0, np.inf, np.nan])
def test_a_speed_is_above_0(speed: float) -> None:
    with pytest.raises(ValueError, match="must be above 0"):
        with_constant_speed(photos(0, 1), speed)


def test_lists_of_cameras_have_no_times_and_paths_have(tmp_path: Path) -> None:
    level = [[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    rows = [
        {
            "img_name": f"{k}",
            "width": 60,
            "height": 40,
            "position": [7.0 * k, 0, 0],
            "rotation": level,
            "fx": 50,
            "fy": 50,
        }
        for k in range(3)
    ]
    (tmp_path / "cameras.json").write_text(json.dumps(rows))
    path = read_camera_path(tmp_path / "cameras.json")
    assert not path.is_timed and path.times_s == pytest.approx([0, 7 / WALKING_M_S, 14 / WALKING_M_S])
    key = {"camera_to_world": np.eye(4).ravel().tolist(), "fov": 50.0}
    for seconds, is_timed in (({}, False), ({"seconds": 3}, True)):
        (tmp_path / "path.json").write_text(json.dumps({**seconds, "camera_path": [key, key]}))
        assert read_camera_path(tmp_path / "path.json").is_timed is is_timed


def test_a_scene_folder_knows_and_a_new_scale_keeps_the_pace(tmp_path: Path) -> None:
    scene = replace(small_scene(), metres_per_unit=1.0, path=with_constant_speed(photos(0, 7, 14), WALKING_M_S))
    write_scene(scene, tmp_path / "scene")
    read = read_scene(tmp_path / "scene")
    assert read.path is not None and not read.path.is_timed
    longer = set_length(read, 1.0, 10.0)  # a unit is 10 m
    assert longer.path is not None and longer.path.times_s == pytest.approx([0, 50, 100])
    timed = set_length(replace(read, path=replace(read.path, is_timed=True)), 1.0, 10.0)
    assert timed.path is not None and timed.path.times_s == pytest.approx([0, 5, 10])


def test_who_gives_a_key_a_moment_gives_the_path_times() -> None:
    path = with_constant_speed(photos(0, 7, 14), WALKING_M_S)
    assert move_keyframe(path, 1, 6.0).path.is_timed
    assert stretch_path_time(path, 2.0).is_timed
    assert with_keyframe(path, 3.0, path.camera(3.0, 6, 4)).path.is_timed
    assert not place_keyframe_at(path, 1, np.array([7.0, 1.0, 2.0])).is_timed
