"""Depth completed from sparse points, and masks of what moves and of persons' own making."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from gsrain_engine.datasets.capture import Capture, CaptureError
from gsrain_engine.datasets.depth_maps import (
    camera_height_above_road,
    completed_depth,
    completed_depths,
    measured_depths,
    road_depth,
    static_sweeps,
)
from gsrain_engine.datasets.masks import (
    box_outline,
    is_moving,
    moving_boxes,
    points_in_box,
    read_camera_masks,
    static_mask,
    with_camera_masks,
)
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.datasets.undistort import undistort_frame
from tests.training.drive_capture import HEIGHT, ROAD_Z, WIDTH, box, drive_capture, world_depth

# Completed depth


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


def test_edges_stay_sharp_and_too_little_is_nothing() -> None:
    sparse = np.zeros((30, 40), np.float32)
    sparse[::3, ::3] = 5
    sparse[::3, 21::3] = 20
    assert set(np.unique(np.round(completed_depth(sparse), 2))) == {5.0, 20.0}
    for points in (0, 1, 2):
        few = np.zeros((8, 8), np.float32)
        few[0, :points] = 3
        assert not completed_depth(few).any()
    line = np.zeros((8, 8), np.float32)
    line[3, 1:6] = 4
    assert (completed_depth(line) == 4).all()


@settings(max_examples=20)
@given(st.floats(0.02, 1.0), st.integers(0, 2**32 - 1))
def test_measured_pixels_stay_and_gaps_take_depths_around_them(share: float, seed: int) -> None:
    """Dense measurements too, of which most are surrounded by others."""
    random = np.random.default_rng(seed)
    depth = random.uniform(5, 50, (24, 36)).astype(np.float32)
    sparse = np.where(random.random(depth.shape) < share, depth, 0).astype(np.float32)
    filled = completed_depth(sparse)
    np.testing.assert_array_equal(filled[sparse > 0], sparse[sparse > 0])
    if (sparse > 0).sum() >= 3:
        assert filled.min() >= sparse[sparse > 0].min() / 1.5 and filled.max() <= 51


def test_dense_measurements_on_one_surface_are_interpolated_exactly() -> None:
    plane = np.fromfunction(lambda v, u: 10 / (1 + 0.01 * u + 0.02 * v), (40, 60)).astype(np.float32)
    sparse = plane.copy()
    sparse[10:14, 20:25] = sparse[30, 3:9] = 0
    np.testing.assert_allclose(completed_depth(sparse), plane, rtol=1e-5)


def test_road_and_wall_of_a_drive() -> None:
    view = drive_capture(3).views[1]
    truth = world_depth(view.camera)
    sky = ~np.isfinite(truth)
    measured = measured_depths(drive_capture(3), [view])[0]
    assert (measured > 0).mean() < 0.6
    filled = completed_depth(measured, sky)
    assert (filled[sky] == 0).all() and (filled[~sky] > 0).all()
    assert np.quantile(np.abs(filled[~sky] / truth[~sky] - 1), 0.9) < 0.05  # the rest is where road meets wall
    below = np.s_[-3:, 20:-20]  # nearer than the lowest beam of the lidar
    np.testing.assert_allclose(filled[below], truth[below], rtol=0.1)


def test_a_plane_stands_in_for_a_road_without_points() -> None:
    drive = drive_capture(4)
    clouds = np.concatenate([sweep.points_m for sweep in drive.sweeps]).astype(np.float64)
    few = clouds[(clouds[:, 2] > -1.2) | (np.arange(len(clouds)) % 15 == 0)]
    capture = Capture("points", drive.views, points_m=few, is_metric=False)
    skies = [~np.isfinite(world_depth(view.camera)) for view in capture.views]
    road = np.s_[-20:, 30:-30]
    truth = world_depth(capture.views[0].camera)[road]
    filled = completed_depths(capture, capture.views, measured_depths(capture, capture.views), skies)[0][road]
    assert np.median(np.abs(filled / truth - 1)) < 0.08


def test_the_road_lies_as_deep_as_the_lowest_points() -> None:
    drive = drive_capture(4)
    points = np.concatenate([sweep.points_m for sweep in drive.sweeps]).astype(np.float64)
    assert camera_height_above_road(points, drive.views, (0, 0, 1)) == pytest.approx(-ROAD_Z, abs=0.02)
    assert camera_height_above_road(points[:10], drive.views, (0, 0, 1)) is None
    assert camera_height_above_road(points + [0, 0, 50], drive.views, (0, 0, 1)) is None
    camera = drive.views[0].camera
    depth = road_depth(camera, -ROAD_Z, (0, 0, 1))
    assert np.isinf(depth[: camera.height // 2]).all()
    np.testing.assert_allclose(depth[depth < 20], world_depth(camera)[depth < 20], rtol=1e-4)


# Masks of what moves


@pytest.mark.parametrize(
    ("speed", "seconds", "label", "moves"),
    [
        (3.0, 4, "car", True), (0.0, 4, "car", False), (0.05, 4, "car", False),
        (0.0, 1, "car", True), (0.0, 1, "traffic_cone", False),
    ],
)  # fmt: skip
def test_speed_and_class_decide_what_moves(speed: float, seconds: int, label: str, moves: bool) -> None:
    assert is_moving(box("any", (10, 0), speed, seconds=seconds, label=label)) == moves


@given(st.floats(4, 25), st.floats(-3, 3), st.floats(-20, 20), st.integers(0, 2**32 - 1))
def test_points_of_a_box_fall_into_its_mask(x: float, y: float, speed: float, seed: int) -> None:
    view = drive_capture(3).views[1]
    mover = box("car", (x, y), speed)
    pose = mover.track.pose(view.time_s)
    assert pose is not None
    world = np.random.default_rng(seed).uniform([-2, -1, 0], [2, 1, 1.5], (50, 3)) + pose[:3, 3]
    assert points_in_box(world, mover, view.time_s, 1e-6).all()
    local = world @ view.camera.world_to_camera[:3, :3].T + view.camera.world_to_camera[:3, 3]
    local = local[local[:, 2] > 0.2]
    u = local[:, 0] / local[:, 2] * view.camera.fx + view.camera.cx
    v = local[:, 1] / local[:, 2] * view.camera.fy + view.camera.cy
    inside = (u >= 0) & (u < WIDTH) & (v >= 0) & (v < HEIGHT)
    assert not static_mask(view, [mover])[v[inside].astype(int), u[inside].astype(int)].any()


def test_the_rest_of_the_picture_stays() -> None:
    view = drive_capture(3).views[0]
    behind = box("behind", (-20, 0), 5.0)
    assert 0.9 < static_mask(view, [box("car", (20, 0), 5.0)]).mean() < 1
    assert static_mask(view, [behind]).all() and not len(box_outline(view, behind))
    own = np.ones((HEIGHT, WIDTH), bool)
    own[:10] = False
    np.testing.assert_array_equal(static_mask(replace(view, mask_source=own), []), own)


def test_points_on_movers_leave_the_sweeps() -> None:
    mover, parked = box("car", (10, 0), 5.0), box("parked", (10, 4), 0.0)
    points = np.array([[10, 0, -1], [10, 4, -1], [20, 0, ROAD_Z]], np.float32)
    capture = drive_capture(2, boxes=(mover, parked))
    sweeps = tuple(replace(sweep, points_m=points) for sweep in capture.sweeps)
    static = static_sweeps(replace(capture, sweeps=sweeps))
    assert [len(sweep.points_m) for sweep in static] == [2, 3]  # a second later the car is elsewhere


def test_a_persons_masks_go_to_their_cameras_and_bad_ones_are_named(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="CAM_BACK"):
        read_camera_masks(tmp_path)
    picture = np.zeros((20, 30), np.uint8)
    picture[:10] = 255
    Image.fromarray(picture).save(tmp_path / "FRONT.png")
    views = drive_capture(2).views
    masks = read_camera_masks(tmp_path)
    mask = with_camera_masks(views, masks)[0].mask
    assert mask is not None and mask[: HEIGHT // 2].all() and not mask[HEIGHT // 2 :].any()
    assert with_camera_masks([replace(views[0], sensor="LEFT")], masks)[0].mask is None
    assert with_camera_masks([replace(views[0], sensor="")], masks)[0].mask is not None
    (tmp_path / "FRONT.png").write_text("no picture")
    with pytest.raises(CaptureError, match=r"FRONT\.png"):
        read_camera_masks(tmp_path)


def test_the_following_car_of_a_real_drive_is_masked(test_data: Path) -> None:
    capture = open_capture(test_data / "driving" / "dgp")
    moving = moving_boxes(capture)
    assert {each.class_name for each in moving} == {"Car"} and len(moving) == 4  # the other nine stand
    rear = undistort_frame(capture.views[5], 240)
    mask = static_mask(rear, moving)
    row, column = 80, 117  # the car behind, see the photograph
    assert not mask[row, column] and mask.mean() > 0.98
    depth = measured_depths(capture, [rear])[0][row - 2 : row + 3, column - 2 : column + 3]
    assert not ((depth > 0) & (depth < 25)).any()  # only a mover was hit there
