"""A drive for scenes that came without one: along a camera path, in the scene's own units and axes."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.edits.actors import RIG, drive_along, drive_along_own_path
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation.ground import recorded_route

from .edited_scene import edited_scene

UNIT_M = 0.25
TO_WORLD = Scene("lying", up=(0.0, -1.0, 0.0), metres_per_unit=UNIT_M).scene_to_world


def flown(places_m: np.ndarray, look: np.ndarray) -> tuple[Scene, CameraPath]:
    """A photogrammetry's scene, y down and of a unit of 25 cm, and a camera that was at places of the world."""
    scene = Scene("lying", up=(0.0, -1.0, 0.0), metres_per_unit=UNIT_M)
    to_scene = np.linalg.inv(TO_WORLD)
    cameras: list[Camera] = []
    for place in places_m:
        eye, target = (to_scene[:3, :3] @ each for each in (place, place + look))
        cameras.append(Camera.from_fov(160, 90, 40.0, look_at(eye, target, np.array([0.0, -1.0, 0.0]))))
    return scene, CameraPath.through([0.5 * k for k in range(len(cameras))], cameras)


STRAIGHT_M = np.column_stack([np.zeros(21), np.arange(21.0), np.full(21, 1.6)])
"""20 m along y, 1.6 m above the origin."""


def test_it_drives_where_the_camera_went_in_metres():
    scene, path = flown(STRAIGHT_M, np.array([0.0, 1.0, -0.1]))
    driven = drive_along(scene, path)
    route = recorded_route(driven)
    assert route.length_m == pytest.approx(20, abs=0.01)
    assert route.at(5.0) == pytest.approx((0, 5, np.pi / 2), abs=1e-3)
    pose = driven.ego_to_world(5.0)
    assert pose is not None
    np.testing.assert_allclose(pose, [[0, -1, 0, 0], [1, 0, 0, 10], [0, 0, 1, 1.6], [0, 0, 0, 1]], atol=1e-3)


def test_the_camera_rides_along_as_it_was_turned():
    scene, path = flown(STRAIGHT_M, np.array([0.0, 1.0, -0.1]))
    (front,) = drive_along(scene, path, 160, 90).rigs[RIG]
    assert (front.width, front.height) == (160, 90)
    assert np.degrees(2 * np.arctan(45 / front.fy)) == pytest.approx(40)
    forward = front.camera_to_ego[:3, 2]
    np.testing.assert_allclose(forward, np.array([1, 0, -0.1]) / np.hypot(1, 0.1), atol=1e-3)


def test_own_cameras_stay_and_standing_still_is_no_drive():
    scene, path = flown(STRAIGHT_M, np.array([0.0, 1.0, 0.0]))
    rigs = {"mine": drive_along(scene, path).rigs[RIG]}
    assert drive_along_own_path(replace(scene, path=path, rigs=rigs)).rigs == rigs
    still = flown(STRAIGHT_M[:1].repeat(2, axis=0), np.array([0.0, 1.0, 0.0]))
    with pytest.raises(ValueError, match="less than 0.5 m"):
        drive_along(*still)
    with pytest.raises(ValueError, match="no camera path to drive along"):
        drive_along_own_path(replace(edited_scene(), path=None))
