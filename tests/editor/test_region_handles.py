"""Faces of the rain regions: where their handles are, and what a pull does."""

import numpy as np
import pytest

from gsrain_engine.editor.rain_regions import BoxFaceDrag, FaceHandle, face_handles, inset_view
from gsrain_engine.rain.settings import STREAK_REGION, RegionBox
from gsrain_engine.scene.camera import Camera, look_at

UP = np.array([0.0, 0, 1])


def anchor(yaw=0.7, at=(10.0, -4.0, 2.0)):
    matrix = np.eye(4)
    c, s = np.cos(yaw), np.sin(yaw)
    matrix[:2, :2] = [[c, -s], [s, c]]
    matrix[:3, 3] = at
    return matrix


def project(camera, point):
    x, y, z = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
    return camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy


def test_from_inside_handles_stand_on_what_is_seen():
    """An ego camera that looks ahead sees the front face, and of the floor a part, whose handle lies in the picture."""
    eye = anchor()[:3, 3]
    camera = Camera.from_fov(960, 640, 50.0, look_at(eye, eye + anchor()[:3, 0], UP))
    handles = {handle.face: handle for handle in face_handles(STREAK_REGION, anchor(), camera)}
    assert (0, True) in handles and (2, False) in handles
    assert (0, False) not in handles
    for handle in handles.values():
        x, y = project(camera, handle.point_m)
        assert 0.07 * 960 < x < 0.93 * 960 and 0.07 * 640 < y < 0.93 * 640
        local = np.linalg.inv(anchor()) @ [*handle.point_m, 1.0]
        side = STREAK_REGION.maximum_m if handle.upper else STREAK_REGION.minimum_m
        assert local[handle.axis] == pytest.approx(side[handle.axis], abs=1e-9)


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


def test_a_face_seen_end_on_moves_with_the_mouses_height():
    eye = anchor()[:3, 3]
    camera = Camera.from_fov(960, 640, 50.0, look_at(eye, eye + anchor()[:3, 0], UP))
    (front,) = [each for each in face_handles(STREAK_REGION, anchor(), camera) if each.face == (0, True)]
    middle = FaceHandle(0, True, eye + 5.0 * anchor()[:3, 0], front.normal)
    pull = BoxFaceDrag(middle, STREAK_REGION, "streak_region", camera, (480.0, 320.0))
    assert pull.is_end_on
    assert pull.pulled(480.0, 256.0).maximum_m[0] == pytest.approx(6.0)
    assert pull.pulled(480.0, 384.0).maximum_m[0] == pytest.approx(4.0)


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
