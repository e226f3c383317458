from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.datasets.capture import EGO_HEIGHT_M, CaptureError
from gsrain_engine.datasets.kitti import CAMERA_HEIGHT_M
from gsrain_engine.datasets.open_capture import capture_format, open_capture
from mini_drive import FOCAL, HEIGHT, STEP_M, WIDTH, MiniDrive, turned

TO_OPENCV = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
BASELINE_M = 0.54
LIDAR_TO_VEHICLE = turned(np.radians(1.0), (-0.27, 0.0, 0.08))
TURN = np.radians(4.0)


def vehicle_to_world(sample: int) -> np.ndarray:
    """First camera's place with axes as ours; the car goes ahead, then turns left."""
    return turned(TURN * max(sample - 1, 0), (STEP_M * sample, 0.0, 0.0))


def write_sequence(root: Path, number: str = "00", samples: int = 3) -> Path:
    """A sequence with the pictures of both color cameras; poses in the axes of the first camera, as KITTI has them."""
    folder = root / "sequences" / number
    (root / "poses").mkdir(parents=True, exist_ok=True)
    matrix = np.array([[FOCAL, 0, WIDTH / 2 - 0.5], [0, FOCAL, HEIGHT / 2 - 0.5], [0, 0, 1]])
    lines: list[str] = []
    for camera, shift in ((2, 0.06), (3, 0.06 - BASELINE_M)):
        (folder / f"image_{camera}").mkdir(parents=True)
        placed = np.column_stack([np.eye(3), [shift, 0, 0]])
        lines.append(f"P{camera}: {_row(matrix @ placed)}")
        for k in range(samples):
            (folder / f"image_{camera}/{k:06d}.jpg").write_bytes(MiniDrive().jpeg(k))
    (folder / "calib.txt").write_text("\n".join([*lines, f"Tr: {_row((TO_OPENCV @ LIDAR_TO_VEHICLE)[:3])}"]) + "\n")
    (folder / "times.txt").write_text("".join(f"{k * 0.1037:e}\n" for k in range(samples)))
    poses = [TO_OPENCV @ vehicle_to_world(k) @ np.linalg.inv(TO_OPENCV) for k in range(samples)]
    (root / "poses" / f"{number}.txt").write_text("".join(_row(pose[:3]) + "\n" for pose in poses))
    (folder / "velodyne").mkdir()
    for k in range(samples):
        x, y = np.meshgrid(np.linspace(-9, 9, 25), np.linspace(-6, 6, 17))
        road = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -CAMERA_HEIGHT_M)])
        back = np.linalg.inv(LIDAR_TO_VEHICLE)
        rows = np.column_stack([road @ back[:3, :3].T + back[:3, 3], np.full(len(road), 0.5)])
        rows.astype(np.float32).tofile(folder / f"velodyne/{k:06d}.bin")
    return folder


def _row(values: np.ndarray) -> str:
    return " ".join(f"{value:e}" for value in values.ravel())


def test_reads_a_miniature_exactly(tmp_path: Path) -> None:
    folder = write_sequence(tmp_path)
    for path in (tmp_path, folder):
        assert getattr(capture_format(path), "name", "") == "KITTI odometry"
        capture = open_capture(path)
        assert not capture.problems
        assert len(capture) == 6
    assert capture.sensors == ("image_2", "image_3")
    assert [view.time_s for view in capture][::2] == pytest.approx([0.0, 0.1037, 0.2074])
    left, right = capture[0].camera, capture[1].camera
    # The first camera is at the origin of its poses; the second color camera is to the right of the other.
    np.testing.assert_allclose(left.position, [0.0, 0.06, CAMERA_HEIGHT_M - EGO_HEIGHT_M], atol=1e-5)
    np.testing.assert_allclose(right.position - left.position, [0.0, -BASELINE_M, 0.0], atol=1e-5)
    np.testing.assert_allclose(left.world_to_camera[:3, :3], TO_OPENCV[:3, :3], atol=1e-6)
    assert capture.ego is not None
    np.testing.assert_allclose(capture.ego.positions, [[0, 0, 0], [1.5, 0, 0], [3.0, 0, 0]], atol=1e-5)
    pose = capture.ego.pose(0.2074)
    assert pose is not None
    np.testing.assert_allclose(pose[:3, 0], [np.cos(TURN), np.sin(TURN), 0.0], atol=1e-5)
    for sweep in capture.sweeps:
        assert np.abs(sweep.points_m[:, 2] + EGO_HEIGHT_M).max() < 1e-3
    np.testing.assert_allclose(
        capture.sweeps[0].origin_m, [-0.27, 0.0, 0.08 + CAMERA_HEIGHT_M - EGO_HEIGHT_M], atol=1e-3
    )


def test_names_what_is_missing_and_uses_the_rest(tmp_path: Path) -> None:
    folder = write_sequence(tmp_path)
    (folder / "image_3/000001.jpg").write_bytes(b"")
    (folder / "velodyne/000000.bin").write_bytes(b"12")
    lines = (tmp_path / "poses/00.txt").read_text().splitlines()
    (tmp_path / "poses/00.txt").write_text("\n".join([*lines[:2], "1 2 3"]))
    capture = open_capture(folder)
    assert [view.name for view in capture] == ["0000_image_2", "0000_image_3", "0001_image_2"]
    assert len(capture.sweeps) == 1
    said = "\n".join(capture.problems)
    for part in (
        "image_3 has pictures of 1 moments, another camera of 2",
        "00.txt: line 3",
        "image_3/000001.jpg left out",
        "velodyne/000000.bin left out",
    ):
        assert part in said


def test_a_sequence_without_poses_is_refused_with_what_to_do(tmp_path: Path) -> None:
    folder = write_sequence(tmp_path, "11")
    write_sequence(tmp_path, "04")
    (tmp_path / "poses/11.txt").unlink()
    with pytest.raises(CaptureError, match=r"11\.txt: no poses of this sequence.*COLMAP"):
        open_capture(folder)
    capture = open_capture(tmp_path)
    assert capture.name == "04"
    assert "sequences/11" in capture.problems[0]


@pytest.mark.parametrize(("file", "text"), [("calib.txt", ""), ("times.txt", "zero"), ("times.txt", "")])
def test_refuses_broken_files(tmp_path: Path, file: str, text: str) -> None:
    folder = write_sequence(tmp_path)
    (folder / file).write_text(text)
    with pytest.raises(CaptureError):
        open_capture(folder)
