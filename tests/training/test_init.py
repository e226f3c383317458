"""First Gaussians of a training: on surfaces, in the sky, under the ego, on what moves."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsrain_engine.datasets.capture import Capture, TrackedBox
from gsrain_engine.datasets.depth_maps import depth_priors
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.undistort import undistort_frame
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.gaussians import SH_C0, Gaussians
from gsrain_engine.scene.scene import DrawItem
from gsrain_engine.scene.sky_dome import dome_radius
from gsrain_engine.training import init
from gsrain_engine.training.init import actor_layers, initial_gaussians, initial_sky, inpaint_road
from gsrain_engine.training.surfels import LONGEST, SPREAD, camera_trajectory, split_long_gaussians
from rasterized import rasterize

from .drive_capture import ROAD_Z, SKY, box, drive_capture, world_colors, world_depth
from .small_street import flat_patch


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


def test_the_budget_holds_and_the_same_seed_gives_the_same_bytes(drive: Capture) -> None:
    small, other = (initial_gaussians(drive, drive.views, 400, seed=1) for _ in range(2))
    assert 50 < len(small) <= 400
    assert all(np.array_equal(getattr(small, n), getattr(other, n)) for n in ("means", "scales", "quaternions", "sh"))
    with pytest.raises(ValueError, match="budget of 0"):
        initial_gaussians(drive, drive.views, 0)


def test_movers_leave_a_street_that_goes_on(drive: Capture) -> None:
    """Background behind a moving object in all images is filled in from around it."""
    found = initial_gaussians(replace(drive, boxes=(box("car", (8, 0), 1.0),)), drive.views, 3000)
    middle = rasterize([DrawItem(found, np.eye(4))], drive[0].camera).rgba[34:44, 44:52]
    expected = world_colors(drive[0].camera)[34:44, 44:52]
    assert middle[..., 3].min() > 0.5
    np.testing.assert_allclose(middle[..., :3].mean(axis=(0, 1)), expected.mean(axis=(0, 1)), atol=0.15)


def test_without_any_depth_they_fill_what_the_cameras_see(drive: Capture) -> None:
    found = initial_gaussians(Capture("pictures", drive.views), drive.views, 500, seed=3)
    assert len(found) == 500 and (found.opacities < 0.2).all()
    local = found.means @ drive.views[0].camera.world_to_camera[:3, :3].T
    assert (local[:, 2] > 0).all() and np.ptp(local[:, 2]) > 5
    other = initial_gaussians(Capture("pictures", drive.views), drive.views, 500, seed=4)
    assert not np.array_equal(found.means, other.means)


# Sky


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


def test_a_real_street_begins_as_a_coarse_picture_of_itself(test_data: Path) -> None:
    capture = open_capture(test_data / "driving" / "dgp")
    front = [undistort_frame(view, 160).held() for view in capture.views if view.sensor == "CAMERA_01"]
    found = initial_gaussians(capture, front, 8000)
    sky = initial_sky(capture, front, found, depth_priors(capture, front).skies, 2000)
    frame = rasterize([DrawItem(found, np.eye(4)), DrawItem(sky, np.eye(4))], front[1].camera)
    assert frame.rgba[..., 3].mean() > 0.95
    assert psnr(frame.rgba[..., :3], front[1].image / 255.0) > 15


# Road under the ego, and pieces of road that reach past a camera

WAY = camera_trajectory(drive_capture(5).views, 20.0)


def road_with_a_hole() -> Gaussians:
    road = flat_patch((-12, -8, ROAD_Z), (30, 0, 0), (0, 16, 0), (0.5, 0.4, 0.3), 0.2)
    outside = (np.abs(road.means[:, 0] - 2) > 4) | (np.abs(road.means[:, 1]) > 1.5)
    return road.take(np.flatnonzero(outside))


def from_above(gaussians: Gaussians) -> np.ndarray:
    pose = look_at(np.array([2.0, 0, 4]), np.array([2.0, 0, 0]), np.array([1.0, 0, 0]))
    return rasterize([DrawItem(gaussians, np.eye(4))], Camera(60, 60, 60.0, 60.0, 30.0, 30.0, pose)).rgba


def filled(road: Gaussians, budget: int) -> Gaussians:
    return inpaint_road(road, drive_capture(5).views, WAY, (0.0, 0.0, 1.0), budget, 0.85)


def test_a_hole_under_the_cameras_is_filled_with_the_road_around_it() -> None:
    road = road_with_a_hole()
    assert from_above(road)[30, 30, 3] < 0.05
    found, few = filled(road, 5000), filled(road, 400)
    assert 0 < len(few) <= 400 < len(found) <= 5000 and few.scales.max() > found.scales.max()
    assert np.abs(found.means[:, 2] - ROAD_Z).max() < 0.05
    middle = from_above(Gaussians.concatenate([road, found]))[20:40, 20:40]
    assert middle[..., 3].min() > 0.9
    assert middle[..., :3].reshape(-1, 3).mean(axis=0) == pytest.approx([0.5, 0.4, 0.3], abs=0.05)
    wall = flat_patch((30, -5, ROAD_Z), (0, 10, 0), (0, 0, 6), (0.5, 0.5, 0.5), 0.3)
    for other, budget in ((road, 20), (Gaussians.empty(), 5000), (wall, 5000)):  # no road is invented
        assert len(filled(other, budget)) == 0


def test_long_pieces_near_the_cameras_are_cut_and_cover_the_same() -> None:
    """Two discs 1.5 m under the way of the cameras and one far away, each 2 m long."""
    means = np.array([[1, 0, ROAD_Z], [2, 1, ROAD_Z], [60, 0, 0]], np.float32)
    scales, turns = (np.tile(np.float32(row), (3, 1)) for row in ((2.0, 0.1, 0.01), (1, 0, 0, 0)))
    discs = Gaussians(means, scales, turns, np.full(3, 0.8, np.float32), np.zeros((3, 1, 3), np.float32))
    cut = split_long_gaussians(discs, WAY, 1000)
    near = cut.means[:, 0] < 10
    assert near.sum() > 20 and (cut.scales[near].max(axis=1) <= 1.01 * LONGEST * 1.81).all()
    assert cut.scales[~near].max() == 2.0 and (~near).sum() == 1
    first = near & (cut.means[:, 1] < 0.5)
    steps = np.diff(np.sort(cut.means[first, 0]))
    assert steps == pytest.approx(cut.scales[first, 0][1:] / SPREAD, rel=1e-3)
    assert np.ptp(cut.means[first, 0]) + steps[0] == pytest.approx(2.0 / SPREAD, rel=1e-3)
    assert np.allclose(cut.means[first, 1:], [0, ROAD_Z])
    few = split_long_gaussians(discs, WAY, 3)
    assert len(few) == 3 and few.scales[:2].max() <= LONGEST * 1.81


# Actors


RED = np.array([200, 30, 20], np.uint8)
CAR = box("car", (8, 0.5), 2.0)


def with_car(car: TrackedBox) -> Capture:
    """The rear of the car, which the camera behind it shows, is red in the pictures and has points in the sweeps."""
    capture, views, sweeps = drive_capture(4), [], []
    y, z = (each.ravel() for each in np.meshgrid(np.linspace(-0.95, 0.95, 20), np.linspace(0.2, 1.45, 14)))
    rear = np.stack([np.full(len(y), -1.95), y, z], axis=1)
    for view, sweep in zip(capture.views, capture.sweeps, strict=True):
        points, image = rear + car.track.pose(view.time_s)[:3, 3], view.image.copy()
        x, y, z = view.camera.world_to_camera[:3, :3] @ points.T + view.camera.world_to_camera[:3, 3:]
        u, v = (x / z * view.camera.fx + view.camera.cx, y / z * view.camera.fy + view.camera.cy)
        image[int(v.min()) : int(v.max()) + 1, int(u.min()) : int(u.max()) + 1] = RED
        views.append(replace(view, image_source=image))
        sweeps.append(replace(sweep, points_m=np.concatenate([sweep.points_m, points.astype(np.float32)])))
    return replace(capture, views=tuple(views), sweeps=tuple(sweeps), boxes=(car,))


def test_a_car_becomes_an_actor_in_its_color() -> None:
    capture = with_car(CAR)
    points = init.points_of_box(capture, CAR)
    assert len(points) == 20 * 14  # the same ones in every sweep
    np.testing.assert_allclose(points[:, 0], -1.95, atol=1e-5)
    (actor,) = actor_layers(capture, capture.views)
    assert (actor.id, actor.class_name, actor.size_lwh, actor.track) == ("car", "Car", (4.0, 2.0, 1.5), CAR.track)
    assert np.abs(actor.gaussians.means[:, 1]).max() < 1.0
    view = capture.views[2]
    frame = rasterize([DrawItem(actor.gaussians, actor.pose_at(view.time_s))], view.camera)
    x, y, z = view.camera.world_to_camera[:3] @ (CAR.track.pose(view.time_s) @ [-1.95, 0, 0.8, 1])
    row, column = int(y / z * view.camera.fy + view.camera.cy), int(x / z * view.camera.fx + view.camera.cx)
    color = frame.rgba[row, column]
    assert color[3] > 0.8
    np.testing.assert_allclose(color[:3] / color[3], RED / 255, atol=0.06)
    assert frame.depth is not None and frame.depth[row, column] == pytest.approx(z, abs=0.3)


def test_boxes_that_stand_have_few_points_or_are_in_no_view_are_no_actors(monkeypatch) -> None:
    parked, capture = with_car(box("parked", (8, 0.5), 0.0)), with_car(CAR)
    away = [replace(view, camera=replace(view.camera, cx=1e6)) for view in capture.views]
    for each, views in ((parked, parked.views), (drive_capture(4), capture.views), (capture, away)):
        assert actor_layers(each, views) == ()
    monkeypatch.setattr(init, "MIN_POINTS", 300)
    assert actor_layers(capture, capture.views) == ()
