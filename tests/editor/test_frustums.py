"""Recorded cameras in the picture: where they are, what is in front, and pictures that lie where they were taken."""

import numpy as np
import pytest

from gsrain_engine.editor.overlays import (
    MAX_FRUSTUMS,
    RecordedCameras,
    fov_to_fit_deg,
    frustums,
    image_corners,
    image_grid,
)
from gsrain_engine.scene.camera import Camera, look_at

from .small_capture import UP, small_capture

_ABOVE = Camera.from_fov(300, 200, 60.0, look_at(np.array([-6.0, 1.0, 6.0]), np.array([2.0, 0.0, 1.5]), UP))


def _cameras(count: int = 4) -> RecordedCameras:
    return RecordedCameras(view.camera for view in small_capture(count))


def test_a_pyramid_goes_from_the_eye_to_the_corners_of_the_picture():
    camera = _cameras()[1]
    found = {each.view: each for each in frustums(_cameras(), range(4), 0.5, _ABOVE)}
    assert list(found) == [3, 2, 1, 0]  # the nearest is drawn last
    assert found[1].lines_px.shape == (8, 2, 2)
    assert found[1].lines_px[:4, 0] == pytest.approx(np.tile(found[1].eye_px, (4, 1)))
    corner = np.append(image_corners(camera, 0.5)[2], 1.0)
    x, y, z = (_ABOVE.world_to_camera @ corner)[:3]
    assert found[1].lines_px[2, 1] == pytest.approx([_ABOVE.fx * x / z + 150, _ABOVE.fy * y / z + 100])
    assert [each.view for each in frustums(_cameras(), [0, 3], 0.5, _ABOVE)] == [3, 0]


def test_cameras_behind_the_eye_are_left_out_and_only_the_nearest_are_drawn():
    between = Camera.from_fov(300, 200, 60.0, look_at(np.array([1.6, 0, 1.5]), np.array([9.0, 0, 1.5]), UP))
    assert {each.view for each in frustums(_cameras(), range(4), 0.3, between)} == {2, 3}
    many = _cameras(MAX_FRUSTUMS + 40)
    found = frustums(many, range(len(many)), 0.3, _ABOVE)
    assert len(found) == MAX_FRUSTUMS
    assert found[-1].view == 0
    assert frustums(_cameras(), [], 0.3, _ABOVE) == []


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
