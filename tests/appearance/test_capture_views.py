from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.appearance.capture_views import CaptureViews, color_guided_filter
from gsrain_engine.appearance.scene_views import ViewChoice, chosen_views
from gsrain_engine.datasets.capture import EGO_HEIGHT_M, Capture, Lens
from gsrain_engine.datasets.capture_folder import camera_without_calibration
from gsrain_engine.datasets.open_capture import open_capture
from gsrain_engine.scene.street.layout import Label
from tests.training.drive_capture import HEIGHT, ROAD_Z, WIDTH, box, drive_capture, world_depth

Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""World with z up to one with y up."""


def test_lidar_becomes_dense_depth_and_normals_and_the_sky_is_found():
    capture = drive_capture()
    view = CaptureViews(capture, WIDTH)[2]
    truth = world_depth(capture[2].camera)
    finite = np.isfinite(truth)
    assert view.sky[:8].min() == 1
    assert view.sky[HEIGHT // 2 :].max() == 0
    assert not view.depth[view.sky > 0].any()
    rows = slice(HEIGHT // 2 + 4, HEIGHT)
    np.testing.assert_allclose(view.depth[rows], truth[rows], rtol=0.12)
    assert (view.depth[finite] > 0).mean() > 0.95
    assert np.median(view.normals[rows][..., 2]) > 0.98
    assert view.vehicles.max() == 0
    np.testing.assert_array_equal(view.image, capture[2].image.astype(np.float32) / np.float32(255))


def test_wider_pictures_are_made_smaller_and_never_larger():
    capture = drive_capture(2)
    assert CaptureViews(capture, 48)[0].image.shape == (32, 48, 3)
    assert CaptureViews(capture, 4800)[0].image.shape == (HEIGHT, WIDTH, 3)


def test_boxes_of_vehicles_are_their_pixels_without_the_road_under_them():
    car, walker = box("car", (12.0, 0.0), 0.0), box("man", (12.0, 6.0), 0.0, label="Pedestrian")
    capture = drive_capture(3, boxes=(car, walker), sweeps=())
    view = CaptureViews(capture, WIDTH)[0]
    flagged = view.vehicles > 0
    assert flagged.any()
    assert not flagged[:, : WIDTH // 3].any()
    seen = CaptureViews(replace(capture, boxes=(walker,)), WIDTH)[0]
    assert not seen.vehicles.any()
    with_lidar = CaptureViews(replace(capture, sweeps=drive_capture(3).sweeps), WIDTH)[0]
    road_before_it = with_lidar.vehicles[-10:]  # the scan went through where the box is: all road
    assert not road_before_it.any()


def test_what_a_capture_knows_is_taken_as_it_is():
    plain = drive_capture(2)
    truth = [world_depth(view.camera) for view in plain]
    known = tuple(
        replace(
            view,
            depth_source=np.where(np.isfinite(depth), depth, 0).astype(np.float32),
            sky_source=~np.isfinite(depth),
            normals_source=np.tile(np.float32([0, 0, 1]), (HEIGHT, WIDTH, 1)),
            labels_source=np.where(depth < 5, np.uint8(Label.CAR), np.uint8(Label.ROAD)),
        )
        for view, depth in zip(plain, truth, strict=True)
    )
    view = CaptureViews(replace(plain, views=known, sweeps=()), WIDTH)[1]
    np.testing.assert_array_equal(view.depth, known[1].depth)
    np.testing.assert_array_equal(view.sky > 0.5, known[1].sky)
    np.testing.assert_array_equal(view.normals[..., 2], 1)
    np.testing.assert_array_equal(view.vehicles > 0.5, truth[1] < 5)


def test_a_capture_in_other_units_and_axes_comes_into_the_world():
    metric = drive_capture(4)
    half = 0.5 * np.eye(4) + np.diag([0, 0, 0, 0.5])
    points = np.concatenate([sweep.points_m for sweep in metric.sweeps]).astype(np.float64)
    capture = Capture(
        "model",
        tuple(replace(view, camera=view.camera.moved(Y_UP @ half)) for view in metric),
        points_m=0.5 * points @ Y_UP[:3, :3].T,
        is_metric=False,
        up=tuple(Y_UP[:3, 2]),
    )
    views = CaptureViews(capture, WIDTH)
    scale = EGO_HEIGHT_M / -ROAD_Z
    rows = slice(HEIGHT // 2 + 6, HEIGHT)
    np.testing.assert_allclose(views[1].depth[rows], scale * world_depth(metric[1].camera)[rows], rtol=0.1)
    assert np.median(views[1].normals[rows][..., 2]) > 0.98
    assert views.to_world[:3, :3] @ Y_UP[:3, 2] == pytest.approx([0, 0, 2], abs=0.15)


def test_where_nothing_was_measured_nothing_is_taken_for_road():
    capture = drive_capture(1)
    bare = replace(capture, sweeps=(), views=(replace(capture[0], image_source=_gray_road()),))
    view = CaptureViews(bare, WIDTH)[0]
    assert not view.depth.any() and not view.normals.any()
    assert not view.has_surfaces
    assert view.sky[: HEIGHT // 2 - 4].min() > 0.9
    assert view.sky[HEIGHT // 2 + 4 :].max() < 0.1


def test_a_few_points_say_nothing_of_surfaces_and_a_lidar_does():
    capture = drive_capture(2)
    assert CaptureViews(capture, WIDTH)[0].has_surfaces
    points = np.concatenate([sweep.points_m for sweep in capture.sweeps]).astype(np.float64)
    some = np.random.default_rng(0).choice(len(points), 60, replace=False)
    sparse = replace(capture, sweeps=(), points_m=points[some])
    view = CaptureViews(sparse, WIDTH)[0]
    assert view.depth.any() and not view.has_surfaces  # good enough to match views, not to tell cars from the road
    partly = replace(capture[1], depth_source=np.full((HEIGHT, WIDTH), 5, np.float32))
    views = CaptureViews(replace(capture, sweeps=(), views=(capture[0], partly)), WIDTH)
    assert [view.has_surfaces for view in views] == [False, True]


def test_poses_that_are_all_the_same_are_none():
    plain = replace(drive_capture(2), sweeps=())
    assert all(view.has_pose for view in CaptureViews(plain, WIDTH))
    still = tuple(replace(view, camera=plain[0].camera) for view in plain)
    assert not any(view.has_pose for view in CaptureViews(replace(plain, views=still), WIDTH))
    at_rest = tuple(replace(view, camera=plain[0].camera) for view in drive_capture(2))
    measured = replace(drive_capture(2), views=at_rest)  # a tripod with a lidar
    assert all(view.has_pose for view in CaptureViews(measured, WIDTH))
    assert not any(view.has_pose for view in CaptureViews(replace(plain, has_poses=False), WIDTH))


def _gray_road() -> np.ndarray:
    """Grass, and a gray road that runs to the horizon."""
    image = np.full((HEIGHT, WIDTH, 3), (40, 120, 40), np.uint8)
    image[: HEIGHT // 2] = (120, 160, 230)
    for row in range(HEIGHT // 2, HEIGHT):
        half = 8 + (row - HEIGHT // 2)
        image[row, WIDTH // 2 - half : WIDTH // 2 + half] = 110
    return image


def test_the_edge_of_the_sky_follows_the_picture():
    image = np.full((80, 120, 3), (90, 140, 240), np.uint8)
    image[40:] = 90
    image[20:40, 40:80] = (40, 35, 30)  # a tree
    view = replace(drive_capture(1)[0], camera=camera_without_calibration(120, 80), image_source=image)
    sky = CaptureViews(Capture("p", (view,), is_metric=False, has_poses=False), 120)[0].sky
    assert sky[5:15].min() > 0.95
    assert sky[22:34, 20:38].min() > 0.9
    assert sky[22:36, 44:48].max() < 0.2
    assert sky[22:36, 60:76].max() < 0.2
    assert sky[42:].max() < 0.2


def test_what_is_guessed_goes_along_the_pictures_edges():
    guide = np.zeros((60, 90, 3), np.float32)
    guide[:, 40:] = 0.8
    values = np.where(np.arange(90) < 47, 1.0, 3.0)[None].repeat(60, axis=0).astype(np.float32)
    known = np.ones((60, 90), np.bool_)
    smooth = color_guided_filter(values, guide, known, 12, 0.05)
    assert smooth[30, 38] < 1.2 and smooth[30, 42] > 1.7
    known[:, 45:] = False
    np.testing.assert_allclose(color_guided_filter(values * known, guide, known, 12, 0.05)[30, :60], 1, atol=0.02)


def test_only_what_the_lens_saw_is_learned_from():
    capture = drive_capture(1)
    bent = replace(capture, views=(replace(capture[0], lens=Lens("opencv", (0.3, 0.0, 0.0, 0.0))),))
    views = CaptureViews(bent, WIDTH)
    mask = views.mask("0")
    assert mask is not None
    assert not mask.all()
    assert mask[HEIGHT // 2, WIDTH // 2]
    assert CaptureViews(capture, WIDTH).mask("0") is None


def test_a_real_drive_has_road_sky_and_cars(test_data):
    capture = chosen_views(open_capture(test_data / "driving" / "dgp" / "scene_02"), ViewChoice(sensors=("CAMERA_09",)))
    view = CaptureViews(chosen_views(capture, ViewChoice(count=1)), 160)[0]
    assert 0.05 < view.sky.mean() < 0.4
    assert view.vehicles.sum() > 10
    middle = view.depth[70:80, 70:90]
    assert 3 < np.median(middle) < 15
    assert np.median(view.normals[75:90, 40:120, 2]) > 0.9
