import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.scene.camera import Camera, look_at, read_camera
from gsrain_engine.scene.files import SceneFormatError

UP = np.array([0.0, 0, 1])
coordinates = st.floats(-100, 100)
points = st.tuples(coordinates, coordinates, coordinates).map(np.array)


def project(camera, point):
    x, y, z = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
    return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy]), z


@given(points, points)
def test_look_at_puts_the_target_in_the_middle_and_up_upwards(eye, target):
    if np.linalg.norm((target - eye)[:2]) < 1e-3:
        return
    camera = Camera.from_fov(320, 200, 60.0, look_at(eye, target, UP))
    pixel, depth = project(camera, target)
    assert pixel == pytest.approx([160, 100], abs=1e-4)
    assert depth == pytest.approx(np.linalg.norm(target - eye))
    above, _ = project(camera, target + 1e-3 * UP)
    assert above[1] < pixel[1]
    assert camera.position == pytest.approx(eye, abs=1e-9 * (1 + np.abs(eye).max()))


def test_resizing_keeps_the_vertical_field_of_view():
    camera = Camera(960, 640, 1030.0, 1000.0, 470.0, 330.0)
    smaller = camera.resized(300, 160)
    assert smaller.vertical_fov_deg == pytest.approx(camera.vertical_fov_deg)
    assert smaller.fx / smaller.fy == pytest.approx(1.03)
    assert smaller.cx == pytest.approx(150 - 10 / 4)


def test_a_camera_file_comes_back(tmp_path):
    camera = Camera(640, 480, 500.0, 501.0, 320.5, 240.0, look_at(np.array([1.0, 2, 3]), np.zeros(3), UP))
    file = tmp_path / "camera.json"
    file.write_text(json.dumps(camera.to_json()))
    again = read_camera(file)
    assert again.to_json() == camera.to_json()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fx": 0}, "fx, fy must be above 0"),
        ({"width": 0}, "within 1..16384"),
        ({"width": "wide"}, "can't be read as a number"),
        ({"world_to_camera": [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]}, "rotation without scale"),
        ({"world_to_camera": [[float("nan")] * 4] * 4}, "finite 4x4"),
        ({"world_to_camera": [1, 2, 3]}, "expected 4x4"),
        ({"exposure_s": 0}, "exposure_s"),
    ],
)
def test_bad_camera_files_say_what_is_wrong(tmp_path, change, words):
    file = tmp_path / "camera.json"
    file.write_text(json.dumps(Camera(64, 48, 50.0, 50.0, 32.0, 24.0).to_json() | change))
    with pytest.raises(SceneFormatError, match="camera.json") as error:
        read_camera(file)
    assert words in str(error.value)


def test_missing_field_and_broken_json_are_named(tmp_path):
    file = tmp_path / "camera.json"
    file.write_text('{"width": 3}')
    with pytest.raises(SceneFormatError, match="no field 'world_to_camera'"):
        read_camera(file)
    file.write_text("{")
    with pytest.raises(SceneFormatError, match="not a JSON file"):
        read_camera(file)
