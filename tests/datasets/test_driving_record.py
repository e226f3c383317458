from collections.abc import Iterator

import numpy as np
import pytest

from gsrain_engine.datasets import driving_log
from gsrain_engine.datasets.capture import EGO_HEIGHT_M, CaptureError, CaptureFrame
from gsrain_engine.datasets.driving_log import DrivingLog, LidarScan
from gsrain_engine.datasets.geometry import rigid_from_numbers, rigid_from_quaternion, road_height, translation_pose
from gsrain_engine.scene.camera import Camera


def _record(scans: list[LidarScan]) -> DrivingLog:
    camera = Camera(8, 6, 10.0, 10.0, 4.0, 3.0, translation_pose(np.array([-6.0e5, -5.0e6, -100.0])))
    view = CaptureFrame("a", camera, np.zeros((6, 8, 3), np.uint8), 1.5e9)
    record = DrivingLog("drive", 0.0, [view], [(1.5e9 + 0.25, translation_pose(np.array([6.0e5, 5.0e6, 100.0])))])
    record.scans, record.scan_count = iter(scans), len(scans)
    return record


def _scan(points: np.ndarray) -> LidarScan:
    vehicle = translation_pose(np.array([6.0e5, 5.0e6, 100.0]))
    return LidarScan(
        1.5e9 + 0.3, vehicle, points.astype(np.float32), np.zeros(3), np.arange(len(points), dtype=np.float32)
    )


def test_points_far_from_the_data_sets_origin_keep_their_millimetres() -> None:
    points = np.random.default_rng(1).uniform(-40, 40, (1000, 3))
    capture = _record([_scan(points)]).capture()
    np.testing.assert_allclose(capture.sweeps[0].points_m, points - [0, 0, EGO_HEIGHT_M], atol=1e-5)
    np.testing.assert_allclose(capture[0].camera.position, [0, 0, -EGO_HEIGHT_M], atol=1e-8)
    assert capture.sweeps[0].time_s == 0.3
    assert capture.ego is not None
    assert capture.ego.times.tolist() == [0.25]


def test_a_drive_too_long_for_the_memory_is_thinned_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driving_log, "MAX_POINTS", 1000)
    capture = _record([_scan(np.full((600, 3), 50.0)) for _ in range(5)]).capture()
    assert [len(sweep.points_m) for sweep in capture.sweeps] == [200] * 5
    assert capture.sweeps[0].intensities is not None
    assert capture.sweeps[0].intensities[:3].tolist() == [0.0, 3.0, 6.0]
    assert "1 of 3 points is kept" in capture.problems[0]


def test_problems_that_are_found_while_scans_are_read_are_reported() -> None:
    record = _record([])

    def scans() -> Iterator[LidarScan]:
        record.problems.append("second sweep left out")
        yield _scan(np.zeros((4, 3)))

    record.scans = scans()
    assert record.capture().problems == ("second sweep left out",)


def test_of_many_problems_some_are_reported() -> None:
    record = _record([])
    record.problems = [f"{k}.jpg left out" for k in range(500)]
    told = record.capture().problems
    assert len(told) == 25
    assert told[-1] == "and 476 more problems like these"


def test_without_pictures_or_places_there_is_no_capture() -> None:
    record = _record([])
    record.problems = ["a note", "cam.jpg left out: no such picture"]
    record.views = []
    with pytest.raises(CaptureError, match=r"drive: no picture that can be used \(cam\.jpg left out.* 1 more"):
        record.capture()
    record = _record([])
    record.stamps = []
    with pytest.raises(CaptureError, match="no place of the vehicle"):
        record.capture()


def test_the_road_is_found_below_the_vehicle() -> None:
    """A road that leans by 2 %, with a kerb at its side, a car beside, and noise."""
    random = np.random.default_rng(2)
    x, y = random.uniform(-14, 14, (2, 4000))
    road = np.column_stack([x, y, -0.3 + 0.02 * y + random.normal(0, 0.02, 4000)])
    road[y > 4, 2] += 0.15
    car = np.column_stack([random.uniform(3, 7, 3000), random.uniform(-4, -2, 3000), random.uniform(-0.2, 1.0, 3000)])
    assert road_height([road, car], 0.0) == pytest.approx(-0.3, abs=0.03)


def test_without_points_close_by_the_road_is_where_the_data_set_says() -> None:
    assert road_height([], -1.73) == -1.73
    assert road_height([np.full((500, 3), 30.0)], -1.73) == -1.73


def test_poses_that_are_none_are_refused() -> None:
    with pytest.raises(ValueError, match="12 or 16 numbers, not 9"):
        rigid_from_numbers(np.eye(3))
    with pytest.raises(ValueError, match="without scale or mirroring"):
        rigid_from_numbers(np.diag([1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(ValueError, match="without scale or mirroring"):
        rigid_from_numbers(2 * np.eye(4))
    with pytest.raises(ValueError, match="not zero"):
        rigid_from_quaternion([0, 0, 0, 0], [0, 0, 0])
    rounded = rigid_from_numbers(np.round(rigid_from_quaternion([0.9, 0.1, -0.3, 0.2], [1, 2, 3]), 3))
    np.testing.assert_allclose(rounded[:3, :3] @ rounded[:3, :3].T, np.eye(3), atol=1e-12)
