"""Faces of rain regions, dragged in the picture."""

from itertools import product

import numpy as np
import pytest

from gsrain_engine.editor.rain_regions import BoxFaceDrag, face_handles, inset_view
from gsrain_engine.rain.settings import STREAK_REGION, RegionBox


def anchor(yaw=0.7, at=(10.0, -4.0, 2.0)):
    matrix = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    matrix[:2, :2] = [[c, -s], [s, c]]
    matrix[:3, 3] = at
    return matrix


def project(camera, point):
    x, y, z = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
    return camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy


def drag_of(face, box=STREAK_REGION):
    camera = inset_view(STREAK_REGION, anchor(), 240, 170).camera
    (handle,) = [each for each in face_handles(STREAK_REGION, anchor(), camera, inset=0.0) if each.face == face]
    return BoxFaceDrag(handle, box, "streak_region", camera, project(camera, handle.point_m))


@pytest.mark.parametrize(("axis", "upper"), list(product(range(3), (False, True))))
def test_a_face_follows_the_mouse_along_its_normal(axis, upper):
    """Pulled to where a point 0.8 m farther out is seen, the face stands there; the others stay."""
    drag = drag_of((axis, upper))
    pulled = drag.pulled(*project(drag.camera, drag.handle.point_m + 0.8 * drag.handle.normal))
    expected = np.array([STREAK_REGION.minimum_m, STREAK_REGION.maximum_m])
    expected[int(upper), axis] += 0.8 if upper else -0.8
    assert np.array([pulled.minimum_m, pulled.maximum_m]) == pytest.approx(expected, abs=1e-3)
    assert drag.pulled(*drag.start_px) == STREAK_REGION


def test_no_pull_turns_a_region_inside_out_or_makes_it_too_large():
    drag = drag_of((2, True))
    x, y = drag.start_px
    assert drag.pulled(x, y + 500).size_m[2] == pytest.approx(0.1)
    assert STREAK_REGION.volume_m3 < drag.pulled(x, y - 160).volume_m3 <= 5_000.5
    huge = RegionBox(minimum_m=(-50.0, -50.0, 0.0), maximum_m=(50.0, 50.0, 10.0))
    drag = drag_of((2, True), huge)
    assert drag.pulled(x, y - 100) == huge  # what was typed stays; it can be made smaller
    assert drag.pulled(x, y + 1).maximum_m[2] < 10.0
