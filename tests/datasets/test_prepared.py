"""Undistortion and scaling: pictures of a known pattern through known lenses must come out as a pinhole sees it."""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest

from gsrain_engine.datasets.capture import CaptureFrame, Lens
from gsrain_engine.datasets.geometry import intrinsics, largest_tangent, project_points
from gsrain_engine.datasets.rainsense import find_rain_sequences
from gsrain_engine.datasets.undistort import undistort_frame
from gsrain_engine.scene.camera import Camera

CAMERA = Camera(200, 120, 110.0, 112.0, 103.0, 57.5)
LENSES = {
    "none": None,
    "barrel": Lens("opencv", (-0.3, 0.08, 0.004, -0.003, 0.0)),
    "pincushion": Lens("opencv", (0.15, 0.02, -0.002, 0.001)),
    "rational": Lens("opencv", (0.3, 0.1, 0.001, 0.002, 0.01, 0.5, 0.05, 0.01)),
    "fisheye": Lens("fisheye", (0.03, -0.01, 0.002, -0.0005)),
}


def pattern(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Grey of what lies at tangents x, y from the axis: smooth, and without symmetry."""
    return 128 + 60 * np.sin(7 * x + 1.3 * y) + 50 * np.cos(5 * y - 2.1 * x + 0.5)


def tangents(camera: Camera, lens: Lens | None) -> tuple[np.ndarray, np.ndarray]:
    """Ray of each pixel of a distorted image."""
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 2)
    focal = np.array([camera.fx, camera.fy])
    straight = (pixels - [camera.cx, camera.cy]) / focal
    if lens is not None:
        project = cv2.fisheye.projectPoints if lens.model == "fisheye" else cv2.projectPoints
        still, coefficients = np.zeros(3), np.array(lens.coefficients)
        for _ in range(60):
            rays = np.column_stack([straight, np.ones(len(straight))]).reshape(-1, 1, 3)
            bent, _ = project(rays, still, still, intrinsics(camera), coefficients)
            straight = straight + (pixels - bent.reshape(-1, 2)) / focal * 0.7
        assert np.abs(pixels - bent.reshape(-1, 2)).max() < 1e-3
    straight = straight.reshape(camera.height, camera.width, 2)
    return straight[..., 0], straight[..., 1]


@lru_cache
def photographed(lens: Lens | None) -> CaptureFrame:
    x, y = tangents(CAMERA, lens)
    grey = np.round(pattern(x, y)).astype(np.uint8)
    depth = (10 + 2 * x + y).astype(np.float32)
    return CaptureFrame(
        "v", CAMERA, np.repeat(grey[..., None], 3, axis=2), lens=lens, depth_source=depth, sky_source=y < -0.2
    )


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("width", [None, 200, 100, 67])
def test_straightened_pictures_are_what_a_pinhole_sees(name: str, width: int | None) -> None:
    view = undistort_frame(photographed(LENSES[name]), width)
    assert view.lens is None
    x, y = tangents(view.camera, None)
    seen = np.ones(x.shape, bool) if view.mask is None else view.mask
    assert seen.mean() > 0.75
    off = np.abs(view.image[..., 1].astype(float) - pattern(x, y))[seen]
    assert off.max() < 3 if width != 67 else off.max() < 4  # half a grey level of rounding, and averages over areas
    assert view.depth is not None
    assert view.sky is not None
    depth_off = np.abs(view.depth - (10 + 2 * x + y))[seen]
    assert depth_off.max() < 1.6 * (2 + 1) / min(view.camera.fx, CAMERA.fx)  # the nearest pixel is up to 0.7 px away
    beside = np.abs(y + 0.2) > 1.2 / CAMERA.fy
    np.testing.assert_array_equal(view.sky[seen & beside], (y < -0.2)[seen & beside])


def test_a_wrong_centre_of_pixels_would_be_found() -> None:
    view = undistort_frame(photographed(LENSES["none"]), 50)
    x, y = tangents(view.camera, None)
    right = np.abs(view.image[..., 0] - pattern(x, y)).mean()
    wrong = np.abs(view.image[..., 0] - pattern(x + 0.5 / view.camera.fx, y)).mean()
    assert wrong > 3 * right


def test_pixels_that_the_lens_never_saw_are_masked() -> None:
    view = photographed(LENSES["pincushion"])
    straight = undistort_frame(view)
    assert straight.mask is not None
    x, y = tangents(CAMERA, None)
    pixels, _ = project_points(np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]), CAMERA, view.lens)
    edge = np.minimum(np.minimum(pixels[:, 0], 200 - pixels[:, 0]), np.minimum(pixels[:, 1], 120 - pixels[:, 1]))
    edge = edge.reshape(x.shape)
    assert straight.mask[edge > 1].all()
    assert not straight.mask[edge < -1].any()
    assert (edge < -1).mean() > 0.03
    assert straight.depth is not None
    assert (straight.depth[edge < -1] == 0).all()


def test_masks_hold_only_where_all_that_is_averaged_may_be_learned_from() -> None:
    view = replace(photographed(None), mask_source=np.arange(120)[:, None] + np.zeros(200) >= 61)
    mask = undistort_frame(view, 50).mask
    assert mask is not None
    np.testing.assert_array_equal(mask, np.arange(30)[:, None] + np.zeros(50) >= 16)  # row 15 averages 60 to 63


def test_the_camera_is_scaled_exactly_and_nothing_is_read_before_it_is_asked() -> None:
    def fail() -> np.ndarray:
        raise AssertionError("read too early")

    view = undistort_frame(CaptureFrame("v", CAMERA, fail, depth_source=fail, labels_source=fail), 67)
    assert (view.camera.width, view.camera.height) == (67, 40)
    assert view.camera.fx == pytest.approx(110 * 67 / 200)
    assert view.camera.fy == pytest.approx(112 * 40 / 120)
    assert view.camera.cx / 67 == pytest.approx(103 / 200)
    assert view.mask_source is None
    with pytest.raises(AssertionError, match="too early"):
        _ = view.image
    with pytest.raises(ValueError, match="at least 1 px"):
        undistort_frame(view, 0)


def test_a_view_that_is_ready_stays_itself() -> None:
    view = photographed(None)
    assert undistort_frame(view) is view


@pytest.mark.parametrize("name", ["barrel", "pincushion", "rational", "fisheye"])
def test_points_fall_where_the_lens_bends_them(name: str) -> None:
    lens = LENSES[name]
    x, y = tangents(CAMERA, lens)
    rows, columns = np.mgrid[10:110:20, 10:190:30]
    points = np.stack([x[rows, columns], y[rows, columns], np.ones(rows.shape)], axis=-1).reshape(-1, 3) * 7
    pixels, depths = project_points(points, CAMERA, lens)
    np.testing.assert_allclose(pixels, np.column_stack([columns.ravel() + 0.5, rows.ravel() + 0.5]), atol=1e-3)
    np.testing.assert_allclose(depths, 7)


def test_lenses_that_fold_back_show_nothing_twice() -> None:
    lens = Lens("opencv", (-0.4, 0.0, 0.0, 0.0))  # r - 0.4 r^3 rises up to 1/sqrt(1.2)
    assert largest_tangent(lens) == pytest.approx(1 / np.sqrt(1.2), rel=5e-3)
    beyond, _ = project_points(np.array([[1.4, 0.0, 1.0], [0.9, 0.0, 1.0], [0.0, 0.0, -1.0]]), CAMERA, lens)
    assert np.isnan(beyond[0]).all()
    assert np.isfinite(beyond[1]).all()
    assert np.isnan(beyond[2]).all()
    assert largest_tangent(Lens("fisheye", (0.0, 0.0, 0.0, 0.0))) > 50


def test_the_real_lens_of_rainsense(test_data) -> None:
    """The edge of the stop line and the kerb are straight once the lens is taken out: lines stand out more clearly."""
    sequence = find_rain_sequences(test_data / "weather" / "rainsense")[0]
    view = sequence.capture()[0]
    straight = undistort_frame(view, 1920)
    assert straight.mask is not None
    assert straight.mask.all()  # a barrel lens: its straight picture lies within the bent one
    longest = {}
    for name, picture in (("bent", view.image), ("straight", straight.image)):
        edges = cv2.Canny(cv2.cvtColor(picture[600:], cv2.COLOR_RGB2GRAY), 80, 200)
        lines = cv2.HoughLinesP(edges, 1, np.pi / 720, 120, minLineLength=150, maxLineGap=6).reshape(-1, 4)
        longest[name] = np.sort(np.hypot(*(lines[:, :2] - lines[:, 2:]).T))[-5:].mean()
    assert longest["straight"] > 1.1 * longest["bent"], longest
