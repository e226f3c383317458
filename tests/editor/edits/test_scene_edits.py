"""Edits of the whole scene: scale, level, origin, ego drive."""

from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.editor import Editor
from gsrain_engine.editor.edits.actors import RIG, drive_along, drive_along_own_path, set_origin
from gsrain_engine.editor.edits.level import (
    find_ground,
    level_from_ground,
    level_from_points,
    set_length,
)
from gsrain_engine.editor.viewport.camera import OrbitCamera
from gsrain_engine.editor.viewport.camera_follow import ActorFollower
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.camera_path import CameraPath
from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation.ground import recorded_route
from small_scene import small_scene

from .edited_scene import edited_scene, turned

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


def test_own_cameras_stay_and_standing_still_is_no_drive():
    scene, path = flown(STRAIGHT_M, np.array([0.0, 1.0, 0.0]))
    rigs = {"mine": drive_along(scene, path).rigs[RIG]}
    assert drive_along_own_path(replace(scene, path=path, rigs=rigs)).rigs == rigs
    still = flown(STRAIGHT_M[:1].repeat(2, axis=0), np.array([0.0, 1.0, 0.0]))
    with pytest.raises(ValueError, match="less than 0.5 m"):
        drive_along(*still)
    with pytest.raises(ValueError, match="no camera path to drive along"):
        drive_along_own_path(replace(edited_scene(), path=None))


def tilted():
    """The small scene as it would be captured by a camera that nobody levelled: 12 degrees off, a tenth of a metre."""
    scene, turn = small_scene(), turned(12, 0) @ turned(-7, 1)
    layers = tuple(replace(each, to_scene=turn) for each in scene.layers)
    return replace(scene, layers=layers, ego=None, rigs={}, metres_per_unit=0.1, ground_m=None), turn[:3, 2]


def test_a_known_length_sets_the_metre():
    scene = edited_scene()
    scaled = set_length(scene, 2.0, 5.0)
    assert (scaled.metres_per_unit, scaled.ground_m) == (1.25, -2.5)
    points = [each.part(each.layers[0]).to_world @ [1.0, 2, 3, 1] for each in (scene, scaled)]
    assert points[1][:3] == pytest.approx(2.5 * points[0][:3])
    for measured, true in ((0.0, 1.0), (1.0, -1.0), (1.0, np.inf)):
        with pytest.raises(ValueError, match="above 0"):
            set_length(scene, measured, true)


def test_three_points_level():
    scene, up = tilted()
    corners = np.array([[0.0, 0, 0, 1], [30, 0, 0, 1], [0, 5, 0, 1]])
    points = (corners @ scene.part(scene.layers[0]).to_world.T)[:, :3]
    for order in ([0, 1, 2], [0, 2, 1]):  # either way round
        level = level_from_points(scene, points[order])
        assert level.up == pytest.approx(up)
        assert level.ground_m == pytest.approx(0, abs=1e-9)
    with pytest.raises(ValueError, match="one line"):
        level_from_points(scene, np.outer([0.0, 1, 2], [1.0, 2, 3]))


def test_the_ground_itself_levels():
    scene, up = tilted()
    level = level_from_ground(scene)
    assert level.up == pytest.approx(up, abs=1e-4)
    assert level.ground_m == pytest.approx(0, abs=1e-4)
    assert find_ground(level).up == pytest.approx([0, 0, 1], abs=1e-4)


def test_the_origin_moves_everything():
    scene = replace(edited_scene(), ego=small_scene().ego)
    point = np.array([1.0, 2.0, 3.0])
    there = set_origin(scene, point)
    assert there.ground_m == -4.0
    for time_s in (0.0, 2.0):
        for before, after in zip(scene.parts(time_s), there.parts(time_s), strict=True):
            assert after.to_world[:3, 3] == pytest.approx(before.to_world[:3, 3] - point)
            assert after.to_world[:3, :3] == pytest.approx(before.to_world[:3, :3])
        assert there.ego_to_world(time_s)[:3, 3] == pytest.approx(scene.ego_to_world(time_s)[:3, 3] - point)


def test_the_camera_sees_the_same_where_the_metre_and_up_change():
    editor = Editor(edited_scene())
    layer = editor.document.scene.layers[1]

    def picture():
        camera = editor.viewport.shot(960, 640).camera
        to_camera = camera.world_to_camera @ editor.document.scene.part(editor.document.scene.layers[1]).to_world
        x, y, z = to_camera[:3, :3] @ layer.gaussians.means.T + to_camera[:3, 3:]
        return np.stack([x / z, y / z])

    before = picture()
    editor.document.edit("Scale", set_length, 2.0, 5.0)
    assert picture() == pytest.approx(before)
    editor.document.undo()
    assert picture() == pytest.approx(before)
    editor.document.edit("Level", level_from_points, np.array([[0.0, 0, 0], [1, 0, 0.0], [0, 1, 0.05]]))
    shift = picture() - before
    assert np.abs(shift).max() < 0.2  # roll is lost, so it turns about its line of sight
    editor.close()


def test_the_camera_follows_an_actor_and_keeps_its_offset():
    scene = replace(edited_scene(), up=(0.0, 0.0, 1.0))
    eye, following = OrbitCamera(position=np.array([-5.0, 1.0, 2.0])), ActorFollower()
    following.follow("actors/car")
    following.ride(scene, 1.0, eye)
    assert eye.position == pytest.approx([-5, 1, 2])
    following.ride(scene, 3.0, eye)
    assert eye.position == pytest.approx([-4, 1, 2])  # two units of half a metre
    assert following.velocity_m_s == pytest.approx([0.5, 0, 0])
    following.ride(scene, 3.0, eye)
    assert following.velocity_m_s is None
    eye.position = eye.position + [0, 3, 0]
    following.ride(scene, 1.0, eye)
    assert eye.position == pytest.approx([-5, 4, 2])
    following.ride(replace(scene, actors=()), 2.0, eye)
    assert (following.key, eye.position[0]) == ("", pytest.approx(-5))
