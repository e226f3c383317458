"""Lenses and rolling shutters in files, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.safe_io.errors import SceneFormatError
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.formats.scene_folder import read_scene_folder, write_scene_folder
from gsrain_engine.scene.lens import Lens, lens_numbers
from gsrain_engine.scene.rig import rig_camera
from gsrain_engine.scene.rolling_shutter import RollingShutter
from small_scene import small_scene

FISHEYE = Lens("fisheye", (0.05, -0.02, 0.004, -0.0005), 1.4)
ROLLING = RollingShutter(0.03, "left", (0.1, 0.0, 0.4), (0.0, 0.01, 0.0))


def test_a_camera_file_holds_lens_and_rolling_shutter() -> None:
    camera = Camera(640, 480, 300.0, 301.0, 321.0, 239.0, lens=FISHEYE, rolling=ROLLING)
    again = Camera.from_json(camera.to_json())
    assert (again.lens, again.rolling) == (FISHEYE, ROLLING)
    assert not {"lens", "rolling_shutter"} & camera.pinhole.to_json().keys()
    assert camera.vertical_fov_deg == pytest.approx(89.25, abs=0.05)  # 77.1 without the lens


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"lens": {"model": "opencv", "coefficients": [0.1]}}, r"lens .* \(4, 5, 8, 12, 14\) coefficients, not 1"),
        ({"lens": {"model": "cube", "coefficients": [0.1]}}, "lens can't be read: Invalid enum value 'cube'"),
        ({"lens": {"model": "ftheta", "coefficients": [-1.0]}}, "'ftheta' must rise from the axis on"),
        ({"lens": {"model": "fisheye", "coefficients": [0, 0, 0, 0], "max_angle_rad": 4.0}}, "at most pi, not 4"),
        ({"lens": {"model": "opencv", "coefficients": [0.0] * 12 + [0.1, 0.0]}}, "tilted sensor"),
        ({"rolling_shutter": {"readout_s": -1.0}}, "readout_s must be 0 to 10 s, not -1"),
        ({"rolling_shutter": {"readout_s": 0.01, "direction": "in"}}, "rolling_shutter can't be read: Invalid enum"),
    ],
)  # fmt: skip
def test_impossible_lenses_are_refused(values: dict, words: str) -> None:
    with pytest.raises(SceneFormatError, match=words):
        Camera.from_json(Camera(640, 480, 300.0, 300.0, 320.0, 240.0).to_json() | values)


def test_cameras_of_a_rig_keep_their_lenses_in_a_scene_folder(tmp_path) -> None:
    scene = small_scene()
    front = replace(scene.rigs["one"][0], lens=FISHEYE, readout_s=0.02, readout_direction="up")
    write_scene_folder(replace(scene, rigs={"one": (front,)}), tmp_path / "bent")
    write_scene_folder(scene, tmp_path / "straight")
    again = read_scene_folder(tmp_path / "bent")
    assert again.rigs["one"][0].lens == FISHEYE
    camera = rig_camera(again, "one", "FRONT", 1.5)
    assert camera.rolling is not None and camera.rolling.direction == "up"
    np.testing.assert_allclose(camera.rolling.shift_m, (0, 0, 0.04), atol=1e-12)  # 2 m/s ahead
    assert '"version": 9' in (tmp_path / "bent" / "scene.json").read_text()
    assert '"version": 9' in (tmp_path / "straight" / "scene.json").read_text()
    assert read_scene_folder(tmp_path / "straight").rigs["one"][0].lens is None


def test_poses_between_two_ends_are_those_of_a_steady_motion() -> None:
    """At the ends, and in the middle, of a turn and a shift."""
    start, end = np.eye(4), ROLLING.from_middle(-1.0)  # half a readout before and after some middle
    middle, shutter = RollingShutter.between(start, end, 0.03)
    camera = Camera(64, 48, 50.0, 50.0, 32.0, 24.0, np.linalg.inv(middle), rolling=shutter)
    np.testing.assert_allclose(camera.at_readout(-0.5).camera_to_world, start, atol=1e-9)
    np.testing.assert_allclose(camera.at_readout(0.5).camera_to_world, end, atol=1e-9)


def test_largest_angles_end_a_lens() -> None:
    assert lens_numbers(FISHEYE)[1] == pytest.approx(1.4)
    falls = Lens("ftheta", (1.0, 0.0, -0.3))  # a - 0.3 a^3 rises up to 1.054
    assert lens_numbers(falls)[1] == pytest.approx(1.0541, abs=1e-3)
