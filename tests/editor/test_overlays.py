"""Overlays: frustums of captured cameras, and faces of rain regions."""

import numpy as np
import pytest

from gsrain_engine.editor.overlays import (
    RecordedCameras,
    fov_to_fit_deg,
    image_grid,
)
from gsrain_engine.editor.rain_regions import BoxFaceDrag, face_handles, inset_view
from gsrain_engine.rain.settings import STREAK_REGION, RegionBox
from gsrain_engine.scene.camera import Camera

from .small_capture import small_capture


def _cameras(count: int = 4) -> RecordedCameras:
    return RecordedCameras(view.camera for view in small_capture(count))


def test_from_the_recorded_camera_its_picture_fills_its_own_pixels_at_any_length():
    camera = _cameras()[2]
    for length in (0.1, 7.0):
        grid = image_grid(camera, length, camera, (4, 3))
        assert grid is not None
        assert grid[0, 0] == pytest.approx([0, 0], abs=1e-9)
        assert grid[3, 4] == pytest.approx([80, 48])
        assert grid[1, 2] == pytest.approx([40, 16])


@pytest.mark.parametrize("aspect", [0.6, 1.0, 3.0])
def test_a_whole_recorded_picture_fits_into_the_viewport(aspect: float):
    camera = _cameras()[0]
    width, height = round(300 * aspect), 300
    view = Camera.from_fov(width, height, fov_to_fit_deg(camera, width / height), camera.world_to_camera)
    grid = image_grid(camera, 1.0, view, (1, 1))
    assert grid is not None
    assert grid.min() > -0.01
    assert grid[..., 0].max() < width + 0.01 and grid[..., 1].max() < height + 0.01
    touches = [grid[..., 0].min(), grid[..., 1].min(), width - grid[..., 0].max(), height - grid[..., 1].max()]
    assert min(touches) == pytest.approx(0, abs=1e-6)


def anchor(yaw=0.7, at=(10.0, -4.0, 2.0)):
    matrix = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    matrix[:2, :2] = [[c, -s], [s, c]]
    matrix[:3, 3] = at
    return matrix


def project(camera, point):
    x, y, z = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
    return camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy


@pytest.mark.parametrize("face", [(0, False), (0, True), (1, False), (1, True), (2, False), (2, True)])
def test_a_face_follows_the_mouse_along_its_normal(face):
    """Pulled to where a point 0.8 m farther out is seen, the face stands there; the others stay."""
    camera = inset_view(STREAK_REGION, anchor(), 240, 170).camera
    (handle,) = [each for each in face_handles(STREAK_REGION, anchor(), camera, inset=0.0) if each.face == face]
    pull = BoxFaceDrag(handle, STREAK_REGION, "streak_region", camera, project(camera, handle.point_m))
    pulled = pull.pulled(*project(camera, handle.point_m + 0.8 * handle.normal))
    axis, upper = face
    expected = {"minimum_m": list(STREAK_REGION.minimum_m), "maximum_m": list(STREAK_REGION.maximum_m)}
    expected["maximum_m" if upper else "minimum_m"][axis] += 0.8 if upper else -0.8
    assert pulled.minimum_m == pytest.approx(expected["minimum_m"], abs=1e-3)
    assert pulled.maximum_m == pytest.approx(expected["maximum_m"], abs=1e-3)
    assert pull.pulled(*pull.start_px) == STREAK_REGION


def test_no_pull_turns_a_region_inside_out_or_makes_it_too_large():
    camera = inset_view(STREAK_REGION, anchor(), 240, 170).camera
    top = next(each for each in face_handles(STREAK_REGION, anchor(), camera, inset=0.0) if each.face == (2, True))
    pull = BoxFaceDrag(top, STREAK_REGION, "streak_region", camera, project(camera, top.point_m))
    x, y = pull.start_px
    assert pull.pulled(x, y + 500).size_m[2] == pytest.approx(0.1)
    largest = pull.pulled(x, y - 160)
    assert STREAK_REGION.volume_m3 < largest.volume_m3 <= 5_000.5
    huge = RegionBox(minimum_m=(-50.0, -50.0, 0.0), maximum_m=(50.0, 50.0, 10.0))
    pull = BoxFaceDrag(top, huge, "streak_region", camera, pull.start_px)
    assert pull.pulled(x, y - 100) == huge  # what was typed stays; it can be made smaller
    assert pull.pulled(x, y + 1).maximum_m[2] < 10.0
