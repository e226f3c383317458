"""Wrong conventions of poses are found and named, and right ones pass: on real drives, and on points made up."""

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
MISTAKES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "the matrices are camera to world, not world to camera": np.linalg.inv,
    "the camera axes are OpenGL's (y up, z backward)": lambda pose: FLIP @ pose,
    "the matrices are camera to world, with OpenGL's axes": lambda pose: np.linalg.inv(pose) @ FLIP,
}


def with_poses(capture: Capture, change: Callable[[CaptureFrame], np.ndarray]) -> Capture:
    views = (replace(view, camera=replace(view.camera, world_to_camera=change(view))) for view in capture)
    return replace(capture, views=tuple(views))


def spoilt(capture: Capture, change: Callable[[np.ndarray], np.ndarray]) -> Capture:
    return with_poses(capture, lambda view: change(view.camera.world_to_camera))


def only(capture: Capture, *sensors: str) -> Capture:
    return replace(capture, views=tuple(view.held() for view in capture if view.sensor in sensors))


def swapped(capture: Capture, names: dict[str, str]) -> Capture:
    poses = {(view.sensor, round(view.time_s)): view.camera.world_to_camera for view in capture}
    return with_poses(capture, lambda view: poses[names[view.sensor], round(view.time_s)])


@pytest.fixture(scope="module")
def rear(test_data: Path) -> Capture:
    whole = open_capture(test_data / "driving" / "nuscenes_rear_26")
    return replace(whole, views=tuple(view.held() for view in whole.views[2:5]))


@pytest.fixture(scope="module")
def rig(test_data: Path) -> Capture:
    rig = open_capture(test_data / "driving" / "dgp")
    two_moments = replace(rig, views=tuple(view for view in rig if view.time_s < 1.5))
    return only(two_moments, "CAMERA_05", "CAMERA_09")


@pytest.fixture(scope="module")
def moment(test_data: Path) -> Capture:
    whole = open_capture(test_data / "driving" / "nuscenes_sample")
    return only(whole, "CAM_FRONT_RIGHT", "CAM_FRONT_LEFT", "CAM_BACK_LEFT")


def test_real_poses_of_colmap_pass_whatever_can_be_read(rear: Capture) -> None:
    def broken() -> np.ndarray:
        raise CaptureError("broken")

    (check,) = check_poses(rear)
    assert (check.by, check.verdict) == ("matches", "fits") and check.figure > 0.8
    assert "median epipolar error 0." in check.told
    (check,) = check_poses(replace(rear, views=(replace(rear[0], image_source=broken), *rear.views[1:])))
    assert check.verdict == "fits"


@pytest.mark.parametrize("mistake", MISTAKES)
def test_wrong_conventions_are_found_without_a_lidar(rear: Capture, mistake: str) -> None:
    (check,) = check_poses(spoilt(rear, MISTAKES[mistake]))
    assert check.verdict == "wrong"
    assert check.told.endswith(f": {mistake}.")
    assert check.figure < 0.4


def test_real_poses_of_a_rig_with_a_lidar_pass(rig: Capture) -> None:
    done: list[float] = []
    checks = check_poses(rig, done.append)
    assert [(check.sensor, check.by, check.verdict) for check in checks] == [
        (sensor, by, "fits") for sensor in ("CAMERA_05", "CAMERA_09") for by in ("matches", "lidar")
    ]
    assert done == [0.5, 1.0]


def test_swapped_cameras_are_found_by_both_checks(rig: Capture) -> None:
    other = {"CAMERA_05": "CAMERA_09", "CAMERA_09": "CAMERA_05"}
    for check in check_poses(swapped(rig, other)):
        assert check.verdict == "wrong"
        assert check.told.endswith(f": the poses are those of {other[check.sensor]}.")


def test_one_moment_of_a_rig_is_checked_by_its_lidar(moment: Capture) -> None:
    checks = check_poses(moment)
    assert [(check.by, check.verdict) for check in checks] == [("lidar", "fits")] * 3
    assert min(check.figure for check in checks) > 3


@pytest.mark.parametrize("mistake", MISTAKES)
def test_wrong_conventions_are_found_by_the_lidar(moment: Capture, mistake: str) -> None:
    for check in check_poses(spoilt(moment, MISTAKES[mistake])):
        assert check.verdict == "wrong"
        assert check.told.endswith(f": {mistake}.")


def test_poses_that_nothing_explains_are_doubtful(moment: Capture) -> None:
    turn = np.eye(4)
    turn[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]  # rolled by 90 degrees
    for check in check_poses(spoilt(moment, lambda pose: turn @ pose)):
        assert check.verdict == "doubtful"
        assert "no usual mistake explains it" in check.told


def test_what_can_not_be_checked_is_not(rear: Capture) -> None:
    assert check_poses(replace(rear, has_poses=False)) == ()
    assert check_poses(replace(rear, views=rear.views[:1])) == ()
    still = tuple(replace(view, camera=rear[0].camera) for view in rear)
    assert check_poses(replace(rear, views=still)) == ()
    far = LidarSweep(100.0, np.zeros((5, 3), np.float32), np.zeros(3))
    assert check_poses(replace(rear, views=still, sweeps=(far,))) == ()


def made_up() -> tuple[FeatureMatches, tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(2)
    points = rng.uniform([-5, -3, 6], [5, 3, 20], (200, 3))
    eyes, target, up = np.array([[0.0, 0, 0], [1, 0.2, 0.5]]), np.array([0.0, 0, 12]), np.array([0.1, -1.0, 0])
    poses = [look_at(eye, target, up) for eye in eyes]
    cameras = [Camera(640, 480, 500.0, 500.0, 320.0, 240.0, pose) for pose in poses]
    pixels = [project_points(points, camera)[0] for camera in cameras]
    return FeatureMatches(pixels[0], pixels[1], (cameras[0], cameras[1])), (poses[0], poses[1])


def test_epipolar_lines_measure_errors_and_the_side_of_the_camera() -> None:
    found, (first, second) = made_up()
    true = pose_fit.epipolar_fit(found, (first, second))
    assert true.median_px < 1e-9 and true.explained == 1.0
    moved = replace(found, second=found.second + [0.0, 1.5])
    assert 0.5 < pose_fit.epipolar_fit(moved, (first, second)).median_px < 1.6
    relative = second @ np.linalg.inv(first)
    relative[:3, 3] *= -1  # backward motion: behind the cameras, though the lines fit
    backward = pose_fit.epipolar_fit(found, (first, relative @ first))
    assert backward.median_px < 1e-9 and backward.explained == 0.0
    assert pose_fit.epipolar_fit(found, (first, first)).explained == 0.0  # a pure turn has no lines
