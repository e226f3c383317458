from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gsrain_engine.datasets.capture import Capture
from gsrain_engine.datasets.depth_maps import depth_priors
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.sky_masks import sky_masks
from gsrain_engine.datasets.undistort import undistort_frame
from gsrain_engine.scene.gaussians import SH_C0, Gaussians
from gsrain_engine.scene.scene import DrawItem
from gsrain_engine.training.init import dome_directions, dome_radius, initial_gaussians, initial_sky, round_gaussians
from gsrain_engine.training.surfels import point_colors
from rasterized import rasterize

from .drive_capture import ROAD_Z, SKY, WALL_X, box, drive_capture, world_colors, world_depth


@pytest.fixture(scope="module")
def drive() -> Capture:
    return drive_capture(4)


@pytest.fixture(scope="module")
def first(drive: Capture) -> Gaussians:
    return initial_gaussians(drive, drive.views, 3000)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((a - b) ** 2)))


def test_surfaces_are_covered_in_their_colours(drive: Capture, first: Gaussians) -> None:
    assert 1000 < len(first) <= 3000
    for view in drive.views:
        frame = rasterize([DrawItem(first, np.eye(4))], view.camera)
        ground = np.isfinite(world_depth(view.camera))
        assert np.median(frame.rgba[ground, 3]) > 0.9
        assert psnr(frame.rgba[ground][:, :3], world_colors(view.camera)[ground]) > 17


def test_they_lie_flat_on_road_and_wall(first: Gaussians) -> None:
    on_road = (np.abs(first.means[:, 2] - ROAD_Z) < 0.1) & (first.means[:, 0] < 15)
    on_wall = (np.abs(first.means[:, 0] - WALL_X) < 0.5) & (first.means[:, 2] > -1)
    assert on_road.mean() > 0.2 and on_wall.mean() > 0.1
    for rows, normal in ((on_road, 2), (on_wall, 0)):
        thinnest = first.scales[rows].argmin(axis=1)
        turns = Rotation.from_quat(first.quaternions[rows], scalar_first=True).as_matrix()
        along = np.abs(turns[np.arange(rows.sum()), normal, thinnest])
        assert np.median(along) > 0.98


def test_the_budget_holds_and_the_same_seed_gives_the_same_bytes(drive: Capture) -> None:
    small = initial_gaussians(drive, drive.views, 400, seed=1)
    assert 50 < len(small) <= 400
    again = initial_gaussians(drive, drive.views, 400, seed=1)
    assert all(np.array_equal(getattr(small, n), getattr(again, n)) for n in ("means", "scales", "quaternions", "sh"))


def test_a_budget_that_is_too_small_is_refused(drive: Capture) -> None:
    with pytest.raises(ValueError, match="budget of 0 Gaussians"):
        initial_gaussians(drive, drive.views, 0)


def test_masked_pixels_make_none(drive: Capture) -> None:
    mask = np.ones((64, 96), bool)
    mask[:, :48] = False
    views = [replace(view, mask_source=mask) for view in drive.views]
    right = initial_gaussians(drive, views, 3000)
    upright = right.means[:, 2] > ROAD_Z + 0.3  # the road under the cameras is carried on
    assert upright.sum() > 100 and right.means[upright, 1].max() < 0.3  # y is to the left


def test_movers_leave_a_street_that_goes_on(drive: Capture) -> None:
    """Background behind a moving object in all images is filled in from around it."""
    car = box("car", (8, 0), 1.0)
    capture = replace(drive, boxes=(car,))
    found = initial_gaussians(capture, capture.views, 3000)
    view = capture.views[0]
    frame = rasterize([DrawItem(found, np.eye(4))], view.camera)
    assert frame.rgba[34:44, 44:52, 3].min() > 0.5
    at = world_colors(view.camera)[34:44, 44:52]
    assert np.abs(frame.rgba[34:44, 44:52, :3].mean(axis=(0, 1)) - at.mean(axis=(0, 1))).max() < 0.15


def test_depth_pictures_are_used_where_there_are_some(drive: Capture) -> None:
    depths = [np.where(np.isfinite(d := world_depth(v.camera)), d, 0).astype(np.float32) for v in drive.views]
    views = [replace(view, depth_source=depth) for view, depth in zip(drive.views, depths, strict=True)]
    found = initial_gaussians(Capture("depth", tuple(views)), views, 3000)
    frame = rasterize([DrawItem(found, np.eye(4))], views[0].camera)
    assert frame.depth is not None
    ground = depths[0] > 0
    assert np.median(np.abs(frame.depth[ground] / depths[0][ground] - 1)) < 0.05


def test_without_any_depth_they_fill_what_the_cameras_see(drive: Capture) -> None:
    found = initial_gaussians(Capture("pictures", drive.views), drive.views, 500, seed=3)
    assert len(found) == 500 and (found.opacities < 0.2).all()
    local = found.means @ drive.views[0].camera.world_to_camera[:3, :3].T
    assert (local[:, 2] > 0).all() and np.ptp(local[:, 2]) > 5
    other = initial_gaussians(Capture("pictures", drive.views), drive.views, 500, seed=4)
    assert not np.array_equal(found.means, other.means)


def test_spheres_are_as_large_as_their_neighbours_are_far() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(6) * 0.5] * 3), axis=-1).reshape(-1, 3).astype(np.float64)
    spheres = round_gaussians(grid, np.full((len(grid), 3), 0.5, np.float32), 0.1)
    np.testing.assert_allclose(spheres.scales, 0.5, rtol=1e-5)
    assert len(round_gaussians(grid[:1], np.zeros((1, 3), np.float32), 0.1)) == 1


def test_colours_come_from_views_that_see_the_point(drive: Capture) -> None:
    wall = np.array([[WALL_X, 0.0, 0.0], [WALL_X + 20, 0.0, 0.0], [-50.0, 0, 0]])
    depths = [np.where(np.isfinite(d := world_depth(v.camera)), d, 0).astype(np.float32) for v in drive.views]
    colors, seen = point_colors(wall, drive.views, depths)
    assert seen.tolist() == [True, False, False]  # behind the wall, behind the camera
    np.testing.assert_allclose(colors[0], np.array([0.3, 0.24, 0.18]), atol=0.09)
    assert (colors[1:] == 0.5).all()


def test_the_sky_is_found_by_its_looks(drive: Capture) -> None:
    nothing = [np.zeros((64, 96), np.float32) for _ in drive.views]
    for mask, view in zip(sky_masks(drive.views, nothing), drive.views, strict=True):
        truth = ~np.isfinite(world_depth(view.camera))
        assert (mask == truth).mean() > 0.97
    known = [replace(view, sky_source=np.zeros((64, 96), bool)) for view in drive.views]
    assert not sky_masks(known, nothing)[0].any()


def test_a_tunnel_has_no_sky(drive: Capture) -> None:
    dark = [replace(view, image_source=np.full((64, 96, 3), 40, np.uint8)) for view in drive.views]
    nothing = [np.zeros((64, 96), np.float32) for _ in dark]
    assert not any(mask.any() for mask in sky_masks(dark, nothing))
    assert len(initial_sky(drive, dark, Gaussians.empty(), sky_masks(dark, nothing))) == 0


def test_the_dome_shows_the_sky_everywhere(drive: Capture, first: Gaussians) -> None:
    sky = initial_sky(drive, drive.views, first, depth_priors(drive, drive.views).skies, 1500)
    far = dome_radius(first, drive.views[0].camera.position, True)
    assert far >= 400
    view = drive.views[0]
    frame = rasterize([DrawItem(sky, np.eye(4))], view.camera)
    above = ~np.isfinite(world_depth(view.camera))
    assert frame.rgba[above, 3].min() > 0.97
    np.testing.assert_allclose(frame.rgba[above][:, :3], np.broadcast_to(SKY, (above.sum(), 3)), atol=0.05)
    colors = sky.sh[:, 0] * SH_C0 + 0.5
    np.testing.assert_allclose(colors, np.broadcast_to(SKY, colors.shape), atol=0.02)  # also behind the cameras


def test_directions_are_even_and_above_the_horizon() -> None:
    up = (0.0, -1.0, 0.0)
    directions = dome_directions(2000, up)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    assert (directions @ np.array(up)).min() > -0.06
    octants = np.bincount((directions[:, 0] > 0) * 2 + (directions[:, 2] > 0))
    assert np.ptp(octants) < 20


def test_a_real_street_begins_as_a_coarse_picture_of_itself(test_data: Path) -> None:
    capture = open_capture(test_data / "driving" / "dgp")
    front = [undistort_frame(view, 160).held() for view in capture.views if view.sensor == "CAMERA_01"]
    found = initial_gaussians(capture, front, 8000)
    sky = initial_sky(capture, front, found, depth_priors(capture, front).skies, 2000)
    frame = rasterize([DrawItem(found, np.eye(4)), DrawItem(sky, np.eye(4))], front[1].camera)
    assert frame.rgba[..., 3].mean() > 0.95
    assert psnr(frame.rgba[..., :3], front[1].image / 255.0) > 15
