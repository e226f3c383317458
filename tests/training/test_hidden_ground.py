"""The road under the ego, and pieces of road that reach past a camera."""

import numpy as np
import pytest

from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.scene import DrawItem
from gsrain_engine.training.init import inpaint_road
from gsrain_engine.training.surfels import LONGEST, SPREAD, camera_trajectory, split_long_gaussians
from rasterized import rasterize

from .drive_capture import ROAD_Z, drive_capture
from .small_street import flat_patch

UP = (0.0, 0.0, 1.0)


def road_with_a_hole() -> Gaussians:
    road = flat_patch((-12, -8, ROAD_Z), (30, 0, 0), (0, 16, 0), (0.5, 0.4, 0.3), 0.2)
    outside = (np.abs(road.means[:, 0] - 2) > 4) | (np.abs(road.means[:, 1]) > 1.5)
    return road.take(np.flatnonzero(outside))


def from_above(gaussians: Gaussians) -> np.ndarray:
    pose = look_at(np.array([2.0, 0, 4]), np.array([2.0, 0, 0]), np.array([1.0, 0, 0]))
    return rasterize([DrawItem(gaussians, np.eye(4))], Camera(60, 60, 60.0, 60.0, 30.0, 30.0, pose)).rgba


def test_a_hole_under_the_cameras_is_filled_with_the_road_around_it() -> None:
    road, views = road_with_a_hole(), drive_capture(5).views
    assert from_above(road)[30, 30, 3] < 0.05
    found = inpaint_road(road, views, camera_trajectory(views, 20.0), UP, 5000, 0.85)
    assert 100 < len(found) <= 5000
    assert np.abs(found.means[:, 2] - ROAD_Z).max() < 0.05
    middle = from_above(Gaussians.concatenate([road, found]))[20:40, 20:40]
    assert middle[..., 3].min() > 0.9
    assert middle[..., :3].reshape(-1, 3).mean(axis=0) == pytest.approx([0.5, 0.4, 0.3], abs=0.05)


def test_fewer_are_larger_and_no_road_is_invented() -> None:
    road, views = road_with_a_hole(), drive_capture(5).views
    few = inpaint_road(road, views, camera_trajectory(views, 20.0), UP, 400, 0.85)
    assert 0 < len(few) <= 400
    assert len(inpaint_road(road, views, camera_trajectory(views, 20.0), UP, 20, 0.85)) == 0
    assert few.scales.max() > inpaint_road(road, views, camera_trajectory(views, 20.0), UP, 5000, 0.85).scales.max()
    assert len(inpaint_road(Gaussians.empty(), views, camera_trajectory(views, 20.0), UP, 5000, 0.85)) == 0
    wall = flat_patch((30, -5, ROAD_Z), (0, 10, 0), (0, 0, 6), (0.5, 0.5, 0.5), 0.3)
    assert len(inpaint_road(wall, views, camera_trajectory(views, 20.0), UP, 5000, 0.85)) == 0


def long_disc() -> Gaussians:
    """Two discs 1.5 m under the way of the cameras and one far away, each 2 m long."""
    return Gaussians(
        np.array([[1, 0, ROAD_Z], [2, 1, ROAD_Z], [60, 0, 0]], np.float32),
        np.tile(np.array([2.0, 0.1, 0.01], np.float32), (3, 1)),
        np.tile(np.array([1, 0, 0, 0], np.float32), (3, 1)),
        np.full(3, 0.8, np.float32),
        np.zeros((3, 1, 3), np.float32),
    )


def test_long_pieces_near_the_cameras_are_cut_and_cover_the_same() -> None:
    way = camera_trajectory(drive_capture(5).views, 20.0)
    cut = split_long_gaussians(long_disc(), way, 1000)
    assert len(cut) > 20
    distance = np.linalg.norm(cut.means[:, None] - way[None], axis=2).min(axis=1)
    near = cut.means[:, 0] < 10
    assert (cut.scales[near].max(axis=1) <= 1.01 * LONGEST * 1.81).all() and (distance[near] > 1).all()
    assert cut.scales[~near].max() == 2.0 and (~near).sum() == 1
    first = near & (cut.means[:, 1] < 0.5)
    steps = np.diff(np.sort(cut.means[first, 0]))
    assert steps == pytest.approx(cut.scales[first, 0][1:] / SPREAD, rel=1e-3)
    assert np.ptp(cut.means[first, 0]) + steps[0] == pytest.approx(2.0 / SPREAD, rel=1e-3)
    assert np.allclose(cut.means[first, 1:], [0, ROAD_Z])


def test_the_number_is_bounded() -> None:
    way = camera_trajectory(drive_capture(5).views, 20.0)
    few = split_long_gaussians(long_disc(), way, 3)
    assert len(few) == 3
    assert few.scales[:2].max() <= LONGEST * 1.81


def test_the_way_goes_on_between_pictures() -> None:
    drive = drive_capture(3, step_m=2.0).views
    assert sorted(camera_trajectory(drive, 20.0)[:, 0].tolist()) == np.arange(0, 4.01, 0.25).tolist()
    assert len(camera_trajectory(drive, 3.0)) == 3  # they may have gone round something
    assert len(camera_trajectory(drive_capture(3, step_m=0.0).views, 20.0)) == 3
