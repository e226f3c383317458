"""Geometry of captures: tracks of boxes, the up direction, the road, logs of drives, and depth from lidar."""

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsrain_engine.datasets import driving_log
from gsrain_engine.datasets.capture import EGO_HEIGHT_M, CaptureError, CaptureFrame, LidarSweep
from gsrain_engine.datasets.driving_log import DrivingLog, LidarScan
from gsrain_engine.datasets.geometry import (
    BoxSample,
    estimate_up_direction,
    lidar_depth,
    nearest_sweep,
    point_depth,
    project_points,
    rigid_from_numbers,
    rigid_from_quaternion,
    road_height,
    tracked_boxes,
    translation_pose,
)
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.lens import Lens

# Tracks of boxes

TIMES = [0.0, 1.0, 2.0, 3.0, 4.0]


def box_sample(time: float, x: float = 0.0, height: float = 2.0) -> BoxSample:
    return BoxSample("a", "car", time, (4.0, 2.0, height), translation_pose(np.array([x, 0.0, 5.0])))


def places(samples: list[BoxSample], *times: float) -> list[float | None]:
    (box,) = tracked_boxes(samples, TIMES)
    poses = [box.track.pose(time) for time in times]
    return [None if pose is None else float(pose[0, 3]) for pose in poses]


def test_a_box_moves_between_its_samples_and_is_there_half_a_step_around_them() -> None:
    drive = [box_sample(time, 10 * time) for time in TIMES]
    # A camera may fire before the first sweep and after the last one: for half a step it moves on.
    assert places(drive, -0.4, 0.0, 0.25, 2.5, 4.0, 4.4) == pytest.approx([-4, 0, 2.5, 25, 40, 44])
    middle = [box_sample(1.0, 10.0), box_sample(2.0, 20.0)]
    assert places(middle, -1.0, 0.0, 0.4, 2.6, 4.0, 9.0) == [None] * 6
    assert places(middle, 0.6, 2.4) == pytest.approx([6.0, 24.0])
    gaps = [box_sample(0.0, 0.0), box_sample(2.0, 20.0), box_sample(4.0, 40.0)]
    assert places(gaps, 0.4, 0.6, 1.4, 1.6, 2.4, 2.6, 3.4, 3.6) == [0, None, None, 20, 20, None, None, 40]
    (single,) = tracked_boxes([box_sample(7.0)], [7.0])
    assert single.track.pose(7.3) is not None and len(single.track.times) == 1


def test_a_box_stands_on_its_bottom_and_has_its_median_size() -> None:
    (box,) = tracked_boxes([box_sample(k, height=h) for k, h in enumerate((2.0, 2.1, 9.0))], TIMES)
    assert box.size_lwh == (4.0, 2.0, 2.1)
    (box,) = tracked_boxes([box_sample(time) for time in TIMES], TIMES)
    np.testing.assert_allclose(box.track.positions[:, 2], 4.0)


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf, 1e9])
def test_sizes_that_no_thing_has_are_refused(wrong: float) -> None:
    with pytest.raises(ValueError, match="0 to 1000 m"):
        BoxSample("a", "car", 0.0, (1.0, wrong, 1.0), np.eye(4))


# Up, the road and poses

TURN = np.linalg.qr(np.random.default_rng(8).normal(size=(3, 3)))[0]
TURN *= np.linalg.det(TURN)


def level_camera(eye: tuple[float, ...], ahead: tuple[float, ...]) -> Camera:
    """Level camera of a z-up world, which is then turned away."""
    place, up = TURN @ np.array(eye), TURN @ np.array([0.0, 0.0, 1.0])
    return Camera(64, 48, 50.0, 50.0, 32.0, 24.0, look_at(place, place + TURN @ np.array(ahead), up))


def off_deg(cameras: list[Camera]) -> float:
    return float(np.degrees(np.arccos(np.clip(np.array(estimate_up_direction(cameras)) @ TURN[:, 2], -1, 1))))


def test_up_is_found_for_a_car_a_rig_a_walk_and_a_drone() -> None:
    drive = [level_camera((float(x), 0.02 * x, 0.0), (1.0, 0.0, -0.2)) for x in range(20)]
    assert off_deg(drive) < 0.3  # the pictures' own up is 11 degrees off
    assert off_deg(drive[:1]) == pytest.approx(np.degrees(np.arctan(0.2)), abs=0.1)  # one picture alone is so far off
    around = np.radians(np.arange(0, 360, 20))
    rig = [level_camera((0.0, 0.0, 0.0), (np.cos(a), np.sin(a), -0.3)) for a in around[::3]]
    walk = [level_camera((4 * np.cos(a), 4 * np.sin(a), 2.0), (-np.cos(a), -np.sin(a), -0.4)) for a in around]
    drone = [level_camera((0.0, 0.0, float(z)), (1.0, 0.1, 0.0)) for z in range(10)]
    assert max(map(off_deg, (rig, walk, drone))) < 0.5


def test_the_road_is_found_below_the_vehicle() -> None:
    """A road that leans by 2 %, with a kerb at its side, a car, and noise."""
    random = np.random.default_rng(2)
    x, y = random.uniform(-14, 14, (2, 4000))
    road = np.column_stack([x, y, -0.3 + 0.02 * y + random.normal(0, 0.02, 4000)])
    road[y > 4, 2] += 0.15
    car = np.column_stack([random.uniform(3, 7, 3000), random.uniform(-4, -2, 3000), random.uniform(-0.2, 1.0, 3000)])
    assert road_height([road, car], 0.0) == pytest.approx(-0.3, abs=0.03)
    # Without points close by it is where the data set has it.
    assert road_height([], -1.73) == road_height([np.full((500, 3), 30.0)], -1.73) == -1.73


def test_poses_that_are_none_are_refused() -> None:
    for values, problem in (
        (np.eye(3), "12 or 16 numbers, not 9"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "without scale or mirroring"),
        (2 * np.eye(4), "without scale or mirroring"),
    ):
        with pytest.raises(ValueError, match=problem):
            rigid_from_numbers(values)
    with pytest.raises(ValueError, match="not zero"):
        rigid_from_quaternion([0, 0, 0, 0], [0, 0, 0])
    rounded = rigid_from_numbers(np.round(rigid_from_quaternion([0.9, 0.1, -0.3, 0.2], [1, 2, 3]), 3))
    np.testing.assert_allclose(rounded[:3, :3] @ rounded[:3, :3].T, np.eye(3), atol=1e-12)


# Logs of drives

FAR = translation_pose(np.array([6.0e5, 5.0e6, 100.0]))


def log_of(scans: list[LidarScan]) -> DrivingLog:
    camera = Camera(8, 6, 10.0, 10.0, 4.0, 3.0, np.linalg.inv(FAR))
    view = CaptureFrame("a", camera, np.zeros((6, 8, 3), np.uint8), 1.5e9)
    log = DrivingLog("drive", 0.0, [view], [(1.5e9 + 0.25, FAR)])
    log.scans, log.scan_count = iter(scans), len(scans)
    return log


def scan_of(points: np.ndarray) -> LidarScan:
    return LidarScan(1.5e9 + 0.3, FAR, points.astype(np.float32), np.zeros(3), np.arange(len(points), dtype=np.float32))


def test_points_far_from_the_data_sets_origin_keep_their_millimeters() -> None:
    points = np.random.default_rng(1).uniform(-40, 40, (1000, 3))
    capture = log_of([scan_of(points)]).capture()
    np.testing.assert_allclose(capture.sweeps[0].points_m, points - [0, 0, EGO_HEIGHT_M], atol=1e-5)
    np.testing.assert_allclose(capture[0].camera.position, [0, 0, -EGO_HEIGHT_M], atol=1e-8)
    assert capture.sweeps[0].time_s == 0.3
    assert capture.ego is not None and capture.ego.times.tolist() == [0.25]


def test_a_drive_too_long_for_the_memory_is_thinned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driving_log, "MAX_POINTS", 1000)
    capture = log_of([scan_of(np.full((500, 3), 50.0)) for _ in range(5)]).capture()
    assert [len(sweep.points_m) for sweep in capture.sweeps] == [167] * 5
    assert capture.sweeps[0].intensities is not None
    assert capture.sweeps[0].intensities[:3].tolist() == [0.0, 3.0, 6.0]
    assert "1 of 3 points is kept" in capture.problems[0]


def test_problems_are_reported_in_part_and_with_the_error() -> None:
    log = log_of([])

    def scans() -> Iterator[LidarScan]:
        log.problems.extend(f"{k}.jpg left out" for k in range(500))
        yield scan_of(np.zeros((4, 3)))

    log.scans = scans()
    problems = log.capture().problems  # found while scans are read
    assert len(problems) == 25 and problems[-1] == "and 476 more problems like these"
    few = log_of([])
    few.problems = log.problems[:25]
    assert few.capture().problems == tuple(log.problems[:25])
    log.views = []
    with pytest.raises(CaptureError, match=r"drive: no picture that can be used \(499\.jpg left out.* 499 more"):
        log.capture()
    log = log_of([])
    log.stamps = []
    with pytest.raises(CaptureError, match="no place of the vehicle"):
        log.capture()


# Depth from lidar: the nearest wins, what nearer surfaces hide is gone, what stands next to them stays

CAMERA = Camera(320, 240, 300.0, 300.0, 160.0, 120.0)
VIEW = CaptureFrame("v", CAMERA, np.zeros((240, 320, 3), np.uint8))


def sweep(points: np.ndarray, time_s: float = 0.0) -> LidarSweep:
    return LidarSweep(time_s, points.astype(np.float32), np.zeros(3))


def wall(depth: float, left: float, right: float, step: float) -> np.ndarray:
    """Points of a wall across the view, `step` apart as tangents."""
    x, y = np.meshgrid(np.arange(left, right, step), np.arange(-0.3, 0.3, step))
    return np.stack([x, y, np.ones(x.shape)], axis=-1).reshape(-1, 3) * depth


@given(st.lists(st.floats(6, 90), min_size=1, max_size=5))
def test_the_nearest_point_of_a_pixel_wins_and_none_behind_or_outside_counts(depths: list[float]) -> None:
    points = [np.array([[0.0, 0, depth]]) for depth in depths]
    outside = np.array([[0.0, 0, -5], [9.0, 0, 5], [0.0, 9, 5]])
    depth = lidar_depth(VIEW, [*map(sweep, points), sweep(outside)])
    assert depth[120, 160] == np.float32(min(depths)) and np.count_nonzero(depth) == 1
    assert not lidar_depth(VIEW, []).any()


def test_a_wall_hides_what_is_behind_it_and_nothing_next_to_it() -> None:
    near, far = wall(8.0, -0.2, 0.1, 0.012), wall(30.0, -0.4, 0.4, 0.0137)
    depth = lidar_depth(VIEW, [sweep(np.concatenate([near, far]))])
    rows, columns = np.nonzero(depth > 20)
    columns = columns[np.abs(rows - 120) < 0.26 * 300]  # its upper and lower ends have nothing beyond
    assert not ((columns > 160 - 0.2 * 300 + 4) & (columns < 160 + 0.09 * 300 - 4)).any()
    assert np.count_nonzero(columns > 160 + 0.1 * 300 + 4) > 450
    assert np.count_nonzero(depth == 8) > 0.95 * len(near)
    # Without the wall all of it counts: nothing far is taken for hidden by itself.
    alone = lidar_depth(VIEW, [sweep(far)])
    assert np.count_nonzero(alone) > 0.95 * len(far[(np.abs(far[:, 1]) < 30 * 0.4)]) * 0.99
    # Points in any unit hide nothing.
    assert np.count_nonzero(point_depth(VIEW, np.concatenate([near, far]) / 100) > 0.2) > 1000


def test_a_road_hides_nothing() -> None:
    x, z = np.meshgrid(np.linspace(-10, 10, 60), np.geomspace(5, 60, 80))
    road = np.stack([x, np.full(x.shape, 1.5), z], axis=-1).reshape(-1, 3)
    pixels, _ = project_points(road, CAMERA)
    inside = (pixels >= 0).all(axis=1) & (pixels < [320, 240]).all(axis=1)
    filled = len(np.unique(pixels[inside].astype(int), axis=0))
    assert np.count_nonzero(lidar_depth(VIEW, [sweep(road)])) == filled


def test_a_lens_and_the_time_of_a_view_are_taken_into_account() -> None:
    bent = CaptureFrame("v", CAMERA, VIEW.image_source, 0.7, lens=Lens("opencv", (-0.3, 0.0, 0.0, 0.0)))
    depth = lidar_depth(bent, [sweep(np.array([[4.0, 0.0, 10.0]]))])
    assert np.argwhere(depth).tolist() == [[120, int(160 + 300 * 0.4 * (1 - 0.3 * 0.16))]]
    sweeps = [sweep(np.zeros((1, 3)), time) for time in (0.0, 0.5, 1.0)]
    assert nearest_sweep(bent, sweeps) is sweeps[1] and nearest_sweep(VIEW, []) is None
