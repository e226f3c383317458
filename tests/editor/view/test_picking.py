from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.editor.viewport.picking import pick, pick_point
from gsrain_engine.render.draw import RenderView
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from small_scene import small_scene


@pytest.fixture
def shot():
    matrix = look_at(np.array([-4.0, 0, 3]), np.array([10.0, 0, 1]), np.array([0.0, 0, 1]))
    return RenderView(Camera.from_fov(320, 240, 50.0, matrix))


def on_plane(shot, x, y, axis, at):
    """Intersection of a pixel's line of sight with a plane."""
    camera = shot.camera
    sight = camera.world_to_camera[:3, :3].T @ [(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0]
    return camera.position + (at - camera.position[axis]) / sight[axis] * sight


@pytest.mark.parametrize("pixel", [(160, 200), (90.5, 180), (250, 230)])
def test_a_pixel_of_the_road_is_a_point_of_the_road(shot, pixel):
    point = pick_point(small_scene(), shot, *pixel)
    assert point == pytest.approx(on_plane(shot, *pixel, axis=2, at=0.0), abs=0.05)
    assert pick(small_scene(), shot, *pixel).key == "layers/road"


def test_the_wall_stands_before_the_sky(shot):
    point = pick_point(small_scene(), shot, 160.0, 100.0)
    assert point == pytest.approx(on_plane(shot, 160.0, 100.0, axis=0, at=40.0), abs=0.05)


def test_sky_is_no_place_but_can_be_picked(shot):
    assert pick_point(small_scene(), shot, 160.0, 20.0) is None
    assert pick(small_scene(), shot, 160.0, 20.0).key == "layers/sky"


def test_what_is_hidden_or_not_asked_for_is_seen_through(shot):
    scene = small_scene()
    assert pick(scene, shot, 160, 80).key == "layers/wall"
    gone = scene.with_member("layers/wall", marks=SelectionFlags(deleted=BitMask.all(400)))
    assert pick(gone, shot, 160, 80).key == "layers/sky"
    assert pick(scene.with_member("layers/wall", visible=False), shot, 160, 80).key == "layers/sky"
    assert pick(scene, shot, 160, 80, lambda member: member.name == "sky").key == "layers/sky"


def test_a_faint_veil_is_looked_through(shot):
    scene = small_scene()
    veil = replace(scene.layers[1].gaussians, opacities=np.full(400, 0.02, np.float32))
    assert pick(scene.with_member("layers/wall", gaussians=veil), shot, 160, 80).key == "layers/sky"
