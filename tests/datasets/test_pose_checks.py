"""Wrong conventions of poses are found and named, and right ones pass: on real drives, and on synthetic points."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.datasets import pose_fit
from gsrain_engine.datasets.capture import Capture, CaptureError, CaptureFrame, LidarSweep
from gsrain_engine.datasets.geometry import project_points
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.pose_check import check_poses
from gsrain_engine.datasets.pose_fit import FeatureMatches
from gsrain_engine.scene.camera import Camera, look_at

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
ROLLED = np.eye(4)[[1, 0, 2, 3]] * [[-1.0], [1.0], [1.0], [1.0]]
"""By 90 degrees."""

MISTAKES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "the matrices are camera to world, not world to camera": np.linalg.inv,
    "the camera axes are OpenGL's (y up, z backward)": lambda pose: FLIP @ pose,
    "the matrices are camera to world, with OpenGL's axes": lambda pose: np.linalg.inv(pose) @ FLIP,
}


def with_poses(capture: Capture, change: Callable[[CaptureFrame], np.ndarray]) -> Capture:
    views = (replace(view, camera=replace(view.camera, world_to_camera=change(view))) for view in capture)
    return replace(capture, views=tuple(views))


def held(capture: Capture, *sensors: str) -> Capture:
    return replace(capture, views=tuple(view.held() for view in capture if view.sensor in sensors))


@pytest.fixture(scope="module")
def rear(test_data: Path) -> Capture:
    whole = open_capture(test_data / "driving" / "nuscenes_rear_26")
    return held(replace(whole, views=whole.views[2:5]), "")


@pytest.fixture(scope="module")
def rig(test_data: Path) -> Capture:
    rig = open_capture(test_data / "driving" / "dgp")
    two_moments = replace(rig, views=tuple(view for view in rig if view.time_s < 1.5))
    return held(two_moments, "CAMERA_05", "CAMERA_09")


@pytest.fixture(scope="module")
def moment(test_data: Path) -> Capture:
    whole = open_capture(test_data / "driving" / "nuscenes_sample")
    return held(whole, "CAM_FRONT_RIGHT", "CAM_FRONT_LEFT", "CAM_BACK_LEFT")


def test_real_poses_pass_whatever_can_be_read(rear: Capture, rig: Capture, moment: Capture) -> None:
    def broken() -> np.ndarray:
        raise CaptureError("broken")

    (check,) = check_poses(rear)
    assert (check.by, check.verdict) == ("matches", "fits") and check.figure > 0.8
    assert "median epipolar error 0." in check.told
    (check,) = check_poses(replace(rear, views=(replace(rear[0], image_source=broken), *rear.views[1:])))
    assert check.verdict == "fits"
    done: list[float] = []
    assert [(check.sensor, check.by, check.verdict) for check in check_poses(rig, done.append)] == [
        (sensor, by, "fits") for sensor in ("CAMERA_05", "CAMERA_09") for by in ("matches", "lidar")
    ]
    assert done == [0.5, 1.0]
    checks = check_poses(moment)
    assert [(check.by, check.verdict) for check in checks] == [("lidar", "fits")] * 3
    assert min(check.figure for check in checks) > 3


@pytest.mark.parametrize("mistake", MISTAKES)
def test_wrong_conventions_are_found_with_and_without_a_lidar(rear: Capture, moment: Capture, mistake: str) -> None:
    for capture, count in ((rear, 1), (moment, 3)):
        checks = check_poses(with_poses(capture, lambda view: MISTAKES[mistake](view.camera.world_to_camera)))
        assert [check.verdict for check in checks] == ["wrong"] * count
        assert all(check.told.endswith(f": {mistake}.") for check in checks)


def test_swapped_cameras_are_found_and_what_nothing_explains_is_doubtful(rig: Capture, moment: Capture) -> None:
    other = {"CAMERA_05": "CAMERA_09", "CAMERA_09": "CAMERA_05"}
    poses = {(view.sensor, round(view.time_s)): view.camera.world_to_camera for view in rig}
    for check in check_poses(with_poses(rig, lambda view: poses[other[view.sensor], round(view.time_s)])):
        assert check.verdict == "wrong" and check.told.endswith(f": the poses are those of {other[check.sensor]}.")
    for check in check_poses(with_poses(moment, lambda view: ROLLED @ view.camera.world_to_camera)):
        assert check.verdict == "doubtful"


def test_what_can_not_be_checked_is_not(rear: Capture) -> None:
    still = tuple(replace(view, camera=rear[0].camera) for view in rear)
    far = LidarSweep(100.0, np.zeros((5, 3), np.float32), np.zeros(3))
    for changes in (
        {"has_poses": False},
        {"views": rear.views[:1]},
        {"views": still},
        {"views": still, "sweeps": (far,)},
    ):
        assert check_poses(replace(rear, **changes)) == ()


def test_epipolar_lines_measure_errors_and_the_side_of_the_camera() -> None:
    points = np.random.default_rng(2).uniform([-5, -3, 6], [5, 3, 20], (200, 3))
    target, up = np.array([0.0, 0, 12]), np.array([0.1, -1.0, 0])
    first, second = (look_at(np.array(eye), target, up) for eye in ([0.0, 0, 0], [1, 0.2, 0.5]))
    cameras = (
        Camera(640, 480, 500.0, 500.0, 320.0, 240.0, first),
        Camera(640, 480, 500.0, 500.0, 320.0, 240.0, second),
    )
    pixels = [project_points(points, camera)[0] for camera in cameras]
    found = FeatureMatches(pixels[0], pixels[1], cameras)
    true = pose_fit.epipolar_fit(found, (first, second))
    assert true.median_px < 1e-9 and true.explained == 1.0
    moved = replace(found, second=found.second + [0.0, 1.5])
    assert 0.5 < pose_fit.epipolar_fit(moved, (first, second)).median_px < 1.6
    relative = second @ np.linalg.inv(first)
    relative[:3, 3] *= -1  # backward motion: behind the cameras, though the lines fit
    backward = pose_fit.epipolar_fit(found, (first, relative @ first))
    assert backward.median_px < 1e-9 and backward.explained == 0.0
    assert pose_fit.epipolar_fit(found, (first, first)).explained == 0.0  # a pure turn has no lines
