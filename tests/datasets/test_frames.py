"""Pictures of views: read from odd files, straightened and scaled, replaced by others, and drawn over."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from gsrain_engine.datasets.capture import Capture, CaptureError, CaptureFrame, LidarSweep, TrackedBox
from gsrain_engine.datasets.capture_folder import write_views
from gsrain_engine.datasets.geometry import intrinsics, project_points
from gsrain_engine.datasets.image_override import flat_name, with_images
from gsrain_engine.datasets.io.images import image_size, read_color, read_labels, read_mask
from gsrain_engine.datasets.summary import chosen_views, contact_sheet, overlay
from gsrain_engine.datasets.undistort import undistort_frame
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.lens import Lens, largest_tangent
from gsrain_engine.scene.scene import PoseTrack

# Files of pictures

NOISE = np.random.default_rng(3).integers(0, 256, (20, 30, 3), np.uint8)


@pytest.mark.parametrize("suffix", ["png", "jpg", "webp", "bmp", "tif"])
def test_sizes_and_colors_of_pictures(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"whole.{suffix}"
    smooth = np.linspace(0, 255, 30).astype(np.uint8)[None, :, None] + np.zeros((20, 30, 3), np.uint8)
    Image.fromarray(smooth).save(file, quality=95)
    assert image_size(file) == (30, 20)
    np.testing.assert_allclose(read_color(file).astype(float), smooth, atol=8)


@given(suffix=st.sampled_from(["png", "jpg"]), part=st.floats(0, 0.99))
def test_cut_pictures_are_found_from_their_ends(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, part: float
) -> None:
    file = tmp_path_factory.getbasetemp() / f"cut.{suffix}"
    Image.fromarray(NOISE).save(file)
    data = file.read_bytes()
    file.write_bytes(data + bytes(200_000))  # a film behind a picture, as phones write it, is no cut
    if suffix == "jpg":
        assert image_size(file) == (30, 20)
    file.write_bytes(data[: int(part * (len(data) - 8))])
    with pytest.raises(CaptureError, match=f"cut.{suffix}: (the picture is cut off|not a readable picture)"):
        image_size(file)
    with pytest.raises(CaptureError, match=f"cut.{suffix}"):
        read_color(file)


def test_gray_of_16_bits_palettes_and_transparency(tmp_path: Path) -> None:
    file = tmp_path / "deep.png"
    Image.fromarray(np.array([[0, 257, 65535]], np.uint16)).save(file)
    np.testing.assert_array_equal(read_color(file)[0, :, 0], [0, 1, 255])
    with pytest.raises(CaptureError, match="values outside 0..255"):
        read_labels(file)
    palette = Image.fromarray(np.array([[0, 1]], np.uint8), "P")
    palette.putpalette([9, 9, 9, 40, 50, 60])
    palette.save(tmp_path / "palette.png", transparency=0)
    assert read_color(tmp_path / "palette.png")[0].tolist() == [[255] * 3, [40, 50, 60]]
    np.testing.assert_array_equal(read_labels(tmp_path / "palette.png"), [[0, 1]])
    np.testing.assert_array_equal(read_mask(tmp_path / "palette.png"), [[False, True]])
    rgba = np.zeros((1, 3, 4), np.uint8)
    rgba[0] = ((250, 0, 90, 0), (100, 0, 0, 255), (0, 0, 0, 51))  # what is fully transparent has a loud color
    Image.fromarray(rgba).save(tmp_path / "clear.png")
    assert read_color(tmp_path / "clear.png")[0].tolist() == [[255, 255, 255], [100, 0, 0], [204, 204, 204]]
    Image.fromarray(np.array([[[0, 0], [80, 255]]], np.uint8), "LA").save(tmp_path / "gray.png")
    assert read_color(tmp_path / "gray.png")[0].tolist() == [[255] * 3, [80] * 3]


# Straightening and scaling: pictures of a known pattern through known lenses come out as a pinhole takes them

CAMERA = Camera(200, 120, 110.0, 112.0, 103.0, 57.5)
LENSES = {
    "none": None,
    "barrel": Lens("opencv", (-0.3, 0.08, 0.004, -0.003, 0.0)),
    "pincushion": Lens("opencv", (0.15, 0.02, -0.002, 0.001)),
    "rational": Lens("opencv", (0.3, 0.1, 0.001, 0.002, 0.01, 0.5, 0.05, 0.01)),
    "fisheye": Lens("fisheye", (0.03, -0.01, 0.002, -0.0005)),
}


def pattern(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Gray of what lies at tangents x, y from the axis: smooth, and without symmetry."""
    return 128 + 60 * np.sin(7 * x + 1.3 * y) + 50 * np.cos(5 * y - 2.1 * x + 0.5)


def tangents(camera: Camera, lens: Lens | None) -> tuple[np.ndarray, np.ndarray]:
    """Ray of each pixel of a distorted image, solved from OpenCV's own projection."""
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
    gray = np.round(pattern(x, y)).astype(np.uint8)
    depth = (10 + 2 * x + y).astype(np.float32)
    return CaptureFrame(
        "v", CAMERA, np.repeat(gray[..., None], 3, axis=2), lens=lens, depth_source=depth, sky_source=y < -0.2
    )


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("width", [None, 200, 100, 67])
def test_straightened_pictures_are_those_of_a_pinhole(name: str, width: int | None) -> None:
    view = undistort_frame(photographed(LENSES[name]), width)
    assert view.lens is None and view.depth is not None and view.sky is not None
    x, y = tangents(view.camera, None)
    inside = np.ones(x.shape, bool) if view.mask is None else view.mask
    assert inside.mean() > 0.75
    off = np.abs(view.image[..., 1].astype(float) - pattern(x, y))[inside]
    assert off.max() < 3 if width != 67 else off.max() < 4  # half a gray level of rounding, and averages over areas
    if width == 100:  # a wrong center of pixels would be found
        shifted = np.abs(view.image[..., 1].astype(float) - pattern(x + 0.5 / view.camera.fx, y))[inside]
        assert shifted.mean() > 2 * off.mean()
    depth_off = np.abs(view.depth - (10 + 2 * x + y))[inside]
    assert depth_off.max() < 1.6 * (2 + 1) / min(view.camera.fx, CAMERA.fx)  # the nearest pixel is up to 0.7 px away
    far_from_edge = np.abs(y + 0.2) > 1.2 / CAMERA.fy
    np.testing.assert_array_equal(view.sky[inside & far_from_edge], (y < -0.2)[inside & far_from_edge])


def test_pixels_outside_of_the_lens_are_masked() -> None:
    view = photographed(LENSES["pincushion"])
    straight = undistort_frame(view)
    assert straight.mask is not None and straight.depth is not None
    x, y = tangents(CAMERA, None)
    pixels, _ = project_points(np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]), CAMERA, view.lens)
    edge = np.minimum(np.minimum(pixels[:, 0], 200 - pixels[:, 0]), np.minimum(pixels[:, 1], 120 - pixels[:, 1]))
    edge = edge.reshape(x.shape)
    assert straight.mask[edge > 1].all() and not straight.mask[edge < -1].any()
    assert (edge < -1).mean() > 0.03 and (straight.depth[edge < -1] == 0).all()
    masked = replace(photographed(None), mask_source=np.arange(120)[:, None] + np.zeros(200) >= 61)
    mask = undistort_frame(masked, 50).mask
    assert mask is not None
    np.testing.assert_array_equal(mask, np.arange(30)[:, None] + np.zeros(50) >= 16)  # row 15 averages 60 to 63


def test_the_camera_is_scaled_exactly_and_nothing_is_read_before_it_is_asked_for() -> None:
    def fail() -> np.ndarray:
        raise AssertionError("read too early")

    view = undistort_frame(CaptureFrame("v", CAMERA, fail, depth_source=fail, labels_source=fail), 67)
    camera = view.camera
    assert (camera.width, camera.height, view.mask_source) == (67, 40, None)
    assert (camera.fx, camera.fy) == pytest.approx((110 * 67 / 200, 112 * 40 / 120))
    assert (camera.cx / 67, camera.cy / 40) == pytest.approx((103 / 200, 57.5 / 120))
    with pytest.raises(AssertionError, match="too early"):
        _ = view.image
    with pytest.raises(ValueError, match="at least 1 px"):
        undistort_frame(view, 0)
    assert undistort_frame(photographed(None)) is photographed(None)


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
    pixels, _ = project_points(np.array([[1.4, 0.0, 1.0], [0.9, 0.0, 1.0], [0.0, 0.0, -1.0]]), CAMERA, lens)
    assert np.isfinite(pixels).all(axis=1).tolist() == [False, True, False]
    assert largest_tangent(Lens("fisheye", (0.0, 0.0, 0.0, 0.0))) > 50


# Other pictures in their place


def views(*names: str, sensors: tuple[str, ...] = ()) -> tuple[CaptureFrame, ...]:
    image, camera = np.zeros((8, 12, 3), np.uint8), Camera(12, 8, 10, 10, 6, 4)
    each = zip(names, sensors or [""] * len(names), strict=True)
    return tuple(CaptureFrame(name, camera, image, float(k), sensor) for k, (name, sensor) in enumerate(each))


def save_gray(file: Path, size: tuple[int, int], value: int = 90) -> None:
    file.parent.mkdir(exist_ok=True)
    Image.new("RGB", size, (value,) * 3).save(file)


def test_other_pictures_are_matched_by_name_and_missing_ones_are_reported(tmp_path: Path) -> None:
    capture = Capture("c", views("a/one", "two", "three.jpg", "four", sensors=("", "CAM", "", "CAM")))
    for k, name in enumerate(["one.png", "CAM/two.png", "three.png", "five.png"]):
        save_gray(tmp_path / name, (12, 8), 10 * (k + 1))
    changed = with_images(capture, tmp_path)
    assert [(view.name, int(view.image[0, 0, 0])) for view in changed] == [
        ("a/one", 10),
        ("two", 20),
        ("three.jpg", 30),
    ]
    assert "1 views have no picture" in changed.problems[0] and "'four' for one" in changed.problems[0]
    assert "1 pictures" in changed.problems[1] and "'five' for one" in changed.problems[1]


def test_pictures_of_another_size_are_resized_and_strange_ones_refused(tmp_path: Path) -> None:
    capture, file = Capture("c", views("one")), tmp_path / "one.png"
    save_gray(file, (24, 16))
    assert with_images(capture, tmp_path)[0].image.shape == (8, 12, 3)
    save_gray(file, (16, 16))
    with pytest.raises(CaptureError, match="is 16x16 px, its view is 12x8"):
        _ = with_images(capture, tmp_path)[0].image
    file.unlink()
    for folder, message in ((tmp_path, "expected one.png"), (tmp_path / "nowhere", "nowhere: no such folder")):
        with pytest.raises(CaptureError, match=message):
            with_images(capture, folder)


@pytest.mark.parametrize("below", [".", "images"])
def test_pictures_with_cameras_are_without_distortion_and_so_are_the_views_then(tmp_path: Path, below: str) -> None:
    bent = replace(views("CAM/one.jpg")[0], lens=Lens("opencv", (-0.2, 0.0, 0.0, 0.0)))
    straight = replace(undistort_frame(bent, 6), name=flat_name(bent.name), mask_source=None)
    list(write_views(tmp_path / below, [replace(straight, image_source=np.full((4, 6, 3), 77, np.uint8))]))
    changed = with_images(Capture("c", (bent,)), tmp_path)
    assert changed.problems == () and changed[0].lens is None
    assert (changed[0].camera.width, changed[0].camera.fx) == (6, 5)
    assert (changed[0].image == 77).all()
    assert changed[0].mask is not None  # pixels outside of the lens are still masked


# Points and boxes drawn over views

AHEAD = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def dark_view(name: str, sensor: str = "", time_s: float = 0.0) -> CaptureFrame:
    camera = Camera(200, 100, 100.0, 100.0, 100.0, 50.0, AHEAD)
    return CaptureFrame(name, camera, np.zeros((100, 200, 3), np.uint8), time_s, sensor)


def test_near_points_are_red_and_far_ones_blue_and_those_of_colmap_are_drawn_without_lidar() -> None:
    points = np.array([[5.0, 2.0, 0.0], [50.0, -20.0, 0.0]], np.float32)
    capture = Capture("c", (dark_view("v"),), sweeps=(LidarSweep(0.0, points, np.zeros(3)),))
    picture = overlay(capture, capture[0], 200)
    near, far = picture[50, 100 - 40].astype(int), picture[50, 100 + 40].astype(int)
    assert near[0] > near[2] + 80 and far[2] > far[0] + 40
    assert picture.any(axis=2).sum() < 30
    sparse = Capture("c", (dark_view("v"),), points_m=np.array([[0.5, 0.0, 0.1]]), is_metric=False)
    rows, columns = np.nonzero(overlay(sparse, sparse[0], 200).any(axis=2))
    assert abs(rows.mean() - 30) < 1 and abs(columns.mean() - 100) < 1


def test_boxes_are_drawn_in_their_time_with_a_red_front() -> None:
    def box_at(place: list[float]) -> TrackedBox:
        track = PoseTrack(np.array([0.0, 1.0]), np.array([place] * 2), np.eye(4)[[0, 0]], np.array([True, False]))
        return TrackedBox("1", "car", (4.0, 2.0, 2.0), track)

    capture = Capture("c", (dark_view("there"), dark_view("gone", time_s=1.5)), boxes=(box_at([10.0, 0, -1]),))
    drawn = overlay(capture, capture[0], 200)
    assert not overlay(capture, capture[1], 200).any()
    # The back face is 8 m away, 2 m wide and high: 25 px around the center; the front, 12 m away, is 16.7 px.
    rows, columns = np.nonzero(drawn.any(axis=2))
    found = [columns.min(), columns.max(), rows.min(), rows.max()]
    np.testing.assert_allclose(found, [87.5, 112.5, 37.5, 62.5], atol=2)
    red = (drawn[..., 0] > 150) & (drawn[..., 2] < 120)
    assert abs(np.nonzero(red)[1].min() - 91.7) < 2
    around = Capture("c", (dark_view("v"),), boxes=(box_at([0.0, 0, -1]),))
    assert overlay(around, around[0], 200).any()  # a box around the camera is cut at it


def test_views_are_chosen_from_all_cameras() -> None:
    capture = Capture("c", tuple(dark_view(f"{s}{k}", s, float(k)) for k in range(9) for s in ("left", "right")))
    assert [each.name for each in chosen_views(capture, 2)] == ["left4", "right4"]
    assert [each.name for each in chosen_views(capture, 6)] == ["left0", "left4", "left8", "right0", "right4", "right8"]
    assert contact_sheet(capture, 4, 100).shape == (2 * (50 + 22), 2 * 100 + 4, 3)
