import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsrain_engine.datasets.capture import Capture
from gsrain_engine.datasets.depth_maps import (
    camera_height_above_road,
    completed_depth,
    completed_depths,
    measured_depths,
    road_depth,
)
from tests.training.drive_capture import ROAD_Z, drive_capture, world_depth


@settings(max_examples=20)
@given(st.floats(-0.2, 0.4), st.floats(-0.2, 0.4), st.floats(3, 30), st.integers(0, 2**32 - 1))
def test_a_plane_comes_back_whole(a: float, b: float, d: float, seed: int) -> None:
    """Inverse depth of a plane is linear in the picture."""
    u, v = np.meshgrid(np.linspace(0, 1, 40), np.linspace(0, 1, 30))
    plane = (d / (1 + a * u + b * v)).astype(np.float32)
    sparse = np.where(np.random.default_rng(seed).random(plane.shape) < 0.5, plane, 0).astype(np.float32)
    frame = np.ones(plane.shape, bool)
    frame[1:-1, 1:-1] = False
    sparse[frame] = plane[frame]
    np.testing.assert_allclose(completed_depth(sparse), plane, rtol=0.03)


def test_edges_stay_sharp() -> None:
    sparse = np.zeros((30, 40), np.float32)
    sparse[::3, ::3] = 5
    sparse[::3, 21::3] = 20
    filled = completed_depth(sparse)
    assert set(np.unique(np.round(filled, 2))) == {5.0, 20.0}


def test_road_and_wall_of_a_drive() -> None:
    view = drive_capture(3).views[1]
    truth = world_depth(view.camera)
    sky = ~np.isfinite(truth)
    measured = measured_depths(drive_capture(3), [view])[0]
    assert (measured > 0).mean() < 0.6
    filled = completed_depth(measured, sky)
    assert (filled[sky] == 0).all() and (filled[~sky] > 0).all()
    error = np.abs(filled[~sky] / truth[~sky] - 1)
    assert np.quantile(error, 0.9) < 0.05  # the rest is where road meets wall
    below = np.s_[-3:, 20:-20]  # nearer than the lowest beam of the lidar
    np.testing.assert_allclose(filled[below], truth[below], rtol=0.1)


@pytest.mark.parametrize("points", [0, 1, 2])
def test_too_little_is_nothing(points: int) -> None:
    sparse = np.zeros((8, 8), np.float32)
    sparse[0, :points] = 3
    assert not completed_depth(sparse).any()


def test_points_on_a_line_do_not_fail() -> None:
    sparse = np.zeros((8, 8), np.float32)
    sparse[3, 1:6] = 4
    assert (completed_depth(sparse) == 4).all()


def test_a_plane_stands_in_for_a_road_without_points() -> None:
    drive = drive_capture(4)
    clouds = np.concatenate([sweep.points_m for sweep in drive.sweeps]).astype(np.float64)
    few = clouds[(clouds[:, 2] > -1.2) | (np.arange(len(clouds)) % 15 == 0)]
    capture = Capture("points", drive.views, points_m=few, is_metric=False)
    measured = measured_depths(capture, capture.views)
    skies = [~np.isfinite(world_depth(view.camera)) for view in capture.views]
    road = np.s_[-20:, 30:-30]
    truth = world_depth(capture.views[0].camera)[road]
    told = completed_depths(capture, capture.views, measured, skies)[0][road]
    assert np.median(np.abs(told / truth - 1)) < 0.08


def test_the_road_lies_as_deep_as_the_lowest_points() -> None:
    drive = drive_capture(4)
    points = np.concatenate([sweep.points_m for sweep in drive.sweeps]).astype(np.float64)
    assert camera_height_above_road(points, drive.views, (0, 0, 1)) == pytest.approx(-ROAD_Z, abs=0.02)
    assert camera_height_above_road(points[:10], drive.views, (0, 0, 1)) is None
    assert camera_height_above_road(points + [0, 0, 50], drive.views, (0, 0, 1)) is None
    camera = drive.views[0].camera
    depth = road_depth(camera, -ROAD_Z, (0, 0, 1))
    assert np.isinf(depth[: camera.height // 2]).all()
    near = depth < 20
    np.testing.assert_allclose(depth[near], world_depth(camera)[near], rtol=1e-4)
