"""KITTI's object detection: pictures with lidar and boxes of their own, and what damage costs."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsrain_engine.datasets.capture import EGO_HEIGHT_M, CaptureError
from gsrain_engine.datasets.geometry import project_points
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from mini_drive import BOX_LWH, STEP_M, points_inside, turned

from .sample_drives import damaged, write_kitti_infos, write_kitti_objects


def test_pictures_of_kitti_s_objects_have_lidar_and_boxes_of_their_own(tmp_path: Path) -> None:
    folder = write_kitti_objects(tmp_path)
    for path in (tmp_path, folder):
        assert getattr(capture_format(path), "name", "") == "KITTI object detection"
        capture = open_capture(path)
        assert (len(capture), len(capture.sweeps), len(capture.boxes), capture.has_poses) == (3, 3, 3, False)
        assert [view.time_s for view in capture] == [0.0, 1.0, 2.0] and "are of different places" in capture.problems[0]
    for number, path in enumerate((tmp_path / "000000", folder / "000001")):
        one = open_capture(path)
        assert (len(one), len(one.sweeps), one.has_poses, one.problems) == (1, 1, True, ())
        place = [1.5, 0.0, 1.6 - EGO_HEIGHT_M]
        np.testing.assert_allclose(one[0].camera.position, place, atol=2e-3)
        ahead = turned(np.radians(5.0), (0.0, 0.0, 0.0))[:3, :3] @ [10.0, 1.0, -0.5] + place
        pixels, depths = project_points(ahead[None], one[0].camera)
        np.testing.assert_allclose([*pixels[0], *depths], [28.0, 26.0, 10.0], atol=0.02)
        (box,) = one.boxes
        assert (box.class_name, box.size_lwh) == ("Car", BOX_LWH)
        pose = box.track.pose(0.0)
        assert pose is not None
        np.testing.assert_allclose(pose[:3, 3], [12.0 - number * STEP_M, 2.0, -EGO_HEIGHT_M], atol=2e-3)
        np.testing.assert_allclose(pose[:3, 0], [np.cos(np.radians(20)), np.sin(np.radians(20)), 0.0], atol=1e-4)
        assert points_inside(one, one.sweeps[0].points_m, 0, 0.0, slack_m=-0.008) == 60


def test_info_files_of_mmdetection3d_hold_the_same_pictures(tmp_path: Path) -> None:
    file = write_kitti_infos(tmp_path)
    folder = tmp_path / "training"
    for number in range(3):
        own, other = open_capture(file / str(number)), open_capture(folder / f"{number:06d}")
        assert len(own) == len(own.sweeps) == len(own.boxes) == 1 and not own.problems
        np.testing.assert_allclose(own[0].camera.world_to_camera, other[0].camera.world_to_camera, atol=1e-6)
        np.testing.assert_allclose(own.sweeps[0].points_m, other.sweeps[0].points_m, atol=1e-6)
        assert own.boxes[0].class_name == "Car" and own.boxes[0].size_lwh == other.boxes[0].size_lwh
        poses = [each.boxes[0].track.pose(0.0) for each in (own, other)]
        assert poses[0] is not None and poses[1] is not None
        np.testing.assert_allclose(poses[0], poses[1], atol=0.02)
    values = pickle.loads(file.read_bytes())
    first, second, third = values["data_list"]
    del first["images"]["CAM2"]["lidar2cam"], second["lidar_points"], third["images"]["CAM2"]["cam2img"]
    file.write_bytes(pickle.dumps(values))
    with pytest.raises(CaptureError, match="no sample that can be used"):
        open_capture(file)


def cut(count: int) -> Any:
    return lambda content: content[:-count]


PICTURES, CALIBRATION = "training/image_2/000001.jpg", "training/calib/000001.txt"
TURN, LABEL = "training/velodyne/000001.bin", "training/label_2/000001.txt"
OBJECT_HOLES: list[tuple[dict[str, Any], tuple[int, int, int], str]] = [
    ({PICTURES: cut(20)}, (2, 2, 3), "image_2/000001.jpg left out"),
    ({PICTURES: None}, (2, 2, 2), ""),
    ({CALIBRATION: None}, (2, 2, 2), "000001 left out: "),
    ({CALIBRATION: b""}, (2, 2, 2), "expected 9 finite numbers at R0_rect, it has no such line"),
    ({CALIBRATION: lambda text: text.replace(b"R0_rect:", b"R0_rect: 9")}, (2, 2, 2), "it has 10 numbers"),
    ({CALIBRATION: lambda text: text.replace(b"R0_rect: 1", b"R0_rect: 7")}, (2, 2, 2), "000001.txt: a pose must be"),
    ({CALIBRATION: lambda text: text.replace(b"Tr_velo_to_cam", b"Tr")}, (2, 2, 2), "numbers at Tr_velo_to_cam"),
    ({CALIBRATION: lambda text: text.replace(b"P2:", b"P9:")}, (2, 2, 3), "expected 12 finite numbers at P2"),
    ({CALIBRATION: lambda text: text.replace(b"P2: 4", b"P2: nan ")}, (2, 2, 3), "expected 12 finite numbers at P2"),
    ({CALIBRATION: b"\xff\xfe"}, (2, 2, 2), "no text"),
    ({TURN: None}, (3, 2, 3), ""),
    ({TURN: b""}, (3, 2, 3), "0 bytes are not rows of 4 numbers"),
    ({TURN: cut(3)}, (3, 2, 3), "bytes are not rows of 4 numbers"),
    ({TURN: np.full(4, np.nan, np.float32).tobytes()}, (3, 2, 3), "not finite, or farther than 100 km"),
    ({LABEL: None}, (3, 3, 2), ""),
    ({LABEL: b"Car 1 2 3\n"}, (3, 3, 2), "label_2/000001.txt: line 1 left out: has 4 words, expected 15"),
    ({LABEL: b"Car" + b" one" * 14}, (3, 3, 2), "line 1 left out: could not convert string to float"),
    ({LABEL: b"Car" + b" 0" * 14}, (3, 3, 2), "line 1 left out: box '000001-0' has sides"),
    ({LABEL: b"Car 0 0 0 0 0 0 0 1 1 1 nan 0 5 0"}, (3, 3, 2), "line 1 left out: "),
    ({LABEL: b"\xff\xff"}, (3, 3, 2), "label_2/000001.txt left out"),
]
"""Damaged files of pictures, the numbers of views, sweeps and boxes that are left, and what names it."""


@pytest.mark.parametrize(("changes", "left", "named"), OBJECT_HOLES)
def test_damage_in_kitti_s_objects_costs_what_it_hits(
    changes: dict[str, Any], left: tuple[int, int, int], named: str, tmp_path: Path
) -> None:
    capture = open_capture(damaged(write_kitti_objects, changes)(tmp_path))
    assert (len(capture), len(capture.sweeps), len(capture.boxes)) == left
    assert named in "\n".join(capture.problems) and len(capture.problems) == 1 + bool(named)
    assert all("\n" not in problem for problem in capture.problems)
