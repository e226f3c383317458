"""Camera paths for other programs come back as the same flight."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.camera_path_io import (
    frame_times,
    read_camera_path,
    write_camera_path,
    write_nerfstudio_path,
    write_training_cameras,
)
from gsrain_engine.scene.files import SceneFormatError


@pytest.fixture
def path():
    rng = np.random.default_rng(5)
    turns = Rotation.from_euler("xyz", rng.uniform(-40, 40, (4, 3)), degrees=True).as_quat()[:, [3, 0, 1, 2]]
    return CameraPath(np.array([0.0, 1, 2, 4]), rng.normal(0, 3, (4, 3)), turns, np.array([50.0, 45, 60, 50]))


def same_view(a, b):
    assert np.allclose(a.world_to_camera, b.world_to_camera, atol=1e-9)
    assert a.fy == pytest.approx(b.fy)


def test_own_file_keeps_what_lies_between_keys(path, tmp_path):
    file = tmp_path / "path.json"
    write_camera_path(file, path)
    assert json.loads(file.read_text())["version"] == 1  # older programs can read it
    changed = replace(path, interpolation="linear", easing="at each key", loop=True)
    write_camera_path(file, changed)
    assert json.loads(file.read_text())["version"] == 2
    again = read_camera_path(file)
    assert (again.interpolation, again.easing, again.loop) == ("linear", "at each key", True)
    for t in (0.0, 1.7, 3.9, 4.6):
        same_view(again.camera(t, 96, 64), changed.camera(t, 96, 64))


@pytest.mark.parametrize(("field", "value"), [("interpolation", "cubic"), ("easing", "bounce")])
def test_unknown_words_are_reported(path, tmp_path, field, value):
    file = tmp_path / "path.json"
    write_camera_path(file, replace(path, loop=True))
    values = json.loads(file.read_text()) | {field: value}
    file.write_text(json.dumps(values))
    with pytest.raises(SceneFormatError, match=f"{field} '{value}' must be one of"):
        read_camera_path(file)


def test_nerfstudio_reads_back_frame_by_frame(path, tmp_path):
    file = tmp_path / "camera_path.json"
    write_nerfstudio_path(file, path, 10.0, 1920, 1080)
    values = json.loads(file.read_text())
    assert (values["render_width"], values["fps"], values["seconds"]) == (1920, 10, 4)
    assert len(values["camera_path"]) == 41
    assert len(values["keyframes"]) == 4
    assert [key["override_transition_sec"] for key in values["keyframes"]] == [1, 1, 2, 0]
    again = read_camera_path(file)
    assert again.times_s == pytest.approx(np.arange(41) / 10)
    for t in (0.0, 0.3, 2.0, 3.9, 4.0):
        same_view(again.camera(t, 96, 64), path.camera(t, 96, 64))


def test_3dgs_cameras_read_back_without_times(path, tmp_path):
    file = tmp_path / "cameras.json"
    write_training_cameras(file, path, 2.0, 600, 400)
    values = json.loads(file.read_text())
    assert set(values[0]) == {"id", "img_name", "width", "height", "position", "rotation", "fx", "fy"}
    again = read_camera_path(file)
    assert len(again.times_s) == 9 and not again.is_timed
    for number in range(9):
        same_view(again.camera(float(again.times_s[number]), 600, 400), path.camera(number / 2, 600, 400))


def test_frames_of_a_loop_do_not_show_its_start_twice(path):
    assert frame_times(path, 2.0).tolist() == [0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4]
    loop = replace(path, loop=True)
    assert len(frame_times(loop, 3.0)) == round(3 * loop.duration_s)
    assert frame_times(replace(path, times_s=path.times_s + 7), 1.0)[0] == 7


def test_a_file_that_can_not_be_written_is_told(path, tmp_path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(OSError, match="file"):
        write_nerfstudio_path(tmp_path / "file" / "path.json", path, 10.0)
