"""Sparse depth from lidar: the nearest wins, what nearer surfaces hide is gone, what stands beside them stays."""

from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.datasets.capture import CaptureFrame, Lens, LidarSweep
from gsrain_engine.datasets.geometry import lidar_depth, nearest_sweep, point_depth, project_points
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.scene.camera import Camera

CAMERA = Camera(320, 240, 300.0, 300.0, 160.0, 120.0)
VIEW = CaptureFrame("v", CAMERA, np.zeros((240, 320, 3), np.uint8))


def sweep(points: np.ndarray, time_s: float = 0.0) -> LidarSweep:
    return LidarSweep(time_s, points.astype(np.float32), np.zeros(3))


def wall(depth: float, left: float, right: float, step: float) -> np.ndarray:
    """Points of a wall across the view, `step` apart as tangents."""
    x, y = np.meshgrid(np.arange(left, right, step), np.arange(-0.3, 0.3, step))
    return np.stack([x, y, np.ones(x.shape)], axis=-1).reshape(-1, 3) * depth


def test_the_nearest_point_of_a_pixel_wins() -> None:
    depth = lidar_depth(VIEW, [sweep(np.array([[0.0, 0, 30], [0.0, 0, 12]])), sweep(np.array([[0.0, 0, 20]]))])
    assert depth[120, 160] == 12
    assert np.count_nonzero(depth) == 1


def test_points_behind_the_camera_and_outside_are_nothing() -> None:
    assert not lidar_depth(VIEW, [sweep(np.array([[0.0, 0, -5], [9.0, 0, 5], [0.0, 9, 5]]))]).any()
    assert not lidar_depth(VIEW, []).any()


def test_a_wall_hides_what_is_behind_it_and_nothing_beside_it() -> None:
    near, far = wall(8.0, -0.2, 0.1, 0.012), wall(30.0, -0.4, 0.4, 0.0137)
    depth = lidar_depth(VIEW, [sweep(np.concatenate([near, far]))])
    rows, columns = np.nonzero(depth > 20)
    columns = columns[np.abs(rows - 120) < 0.26 * 300]  # its upper and lower ends have nothing beyond
    hidden = (columns > 160 - 0.2 * 300 + 4) & (columns < 160 + 0.09 * 300 - 4)
    assert not hidden.any()
    assert np.count_nonzero(columns > 160 + 0.1 * 300 + 4) > 450
    assert np.count_nonzero(depth == 8) > 0.95 * len(near)
    # Without the wall all of it is seen: nothing far is taken for hidden by itself.
    alone = lidar_depth(VIEW, [sweep(far)])
    assert np.count_nonzero(alone) > 0.95 * len(far[(np.abs(far[:, 1]) < 30 * 0.4)]) * 0.99


def test_a_road_hides_nothing() -> None:
    x, z = np.meshgrid(np.linspace(-10, 10, 60), np.geomspace(5, 60, 80))
    road = np.stack([x, np.full(x.shape, 1.5), z], axis=-1).reshape(-1, 3)
    pixels, _ = project_points(road, CAMERA)
    inside = (pixels >= 0).all(axis=1) & (pixels < [320, 240]).all(axis=1)
    pixels_filled = len(np.unique(pixels[inside].astype(int), axis=0))
    assert np.count_nonzero(lidar_depth(VIEW, [sweep(road)])) == pixels_filled


def test_a_lens_is_taken_into_account() -> None:
    lens = Lens("opencv", (-0.3, 0.0, 0.0, 0.0))
    bent = CaptureFrame("v", CAMERA, VIEW.image_source, lens=lens)
    depth = lidar_depth(bent, [sweep(np.array([[4.0, 0.0, 10.0]]))])
    assert np.argwhere(depth).tolist() == [[120, int(160 + 300 * 0.4 * (1 - 0.3 * 0.16))]]


def test_depth_of_points_in_any_unit_knows_no_hiding() -> None:
    both = np.concatenate([wall(0.08, -0.2, 0.1, 0.012), wall(0.3, -0.4, 0.4, 0.0137)])
    assert np.count_nonzero(point_depth(VIEW, both) > 0.2) > 1000


def test_the_sweep_nearest_in_time() -> None:
    sweeps = [sweep(np.zeros((1, 3)), time) for time in (0.0, 0.5, 1.0)]
    assert nearest_sweep(CaptureFrame("v", CAMERA, VIEW.image_source, 0.7), sweeps) is sweeps[1]
    assert nearest_sweep(VIEW, []) is None


def test_real_lidar_is_dense_and_thinned_where_hidden(test_data: Path) -> None:
    capture = open_capture(test_data / "driving" / "nuscenes_sample")
    view = next(view for view in capture if view.sensor == "CAM_FRONT")
    depth = lidar_depth(view, capture.sweeps)
    pixels, depths = project_points(capture.sweeps[0].points_m, view.camera)
    inside = (depths > 0.1) & (pixels >= 0).all(axis=1) & (pixels < [1600, 900]).all(axis=1)
    kept = np.count_nonzero(depth) / np.count_nonzero(inside)
    assert 0.8 < kept < 0.99
    assert depth[depth > 0].min() == pytest.approx(depths[inside].min(), abs=0.01)
