"""Visible objects of a scene in an image."""

from dataclasses import replace

import numpy as np
import pytest

from boxy_scene import FAR_M, NEAR_M, boxy_scene
from gsrain_engine.render.cpu.renderer import CpuRenderer
from gsrain_engine.render.object_labels import visible_objects
from gsrain_engine.scene.flags import BitMask, SelectionFlags
from gsrain_engine.scene.objects import scene_objects
from gsrain_engine.scene.rig import rig_camera

FOCAL, MIDDLE = 240.0, (144.0, 96.0)


def camera_of(scene):
    return rig_camera(scene, "one", "FRONT", 0.0).resized(288, 192)


def seen(scene, camera=None):
    objects = visible_objects(CpuRenderer(), scene, scene_objects(scene), camera or camera_of(scene))
    return {each.object.id: each for each in objects}


@pytest.fixture(scope="module")
def both():
    return seen(boxy_scene())


def test_boxes_are_those_of_visible_pixels(both):
    assert list(both) == ["near", "far"]  # the nearest first
    near, far = both["near"].box_xyxy, both["far"].box_xyxy
    f = FOCAL
    np.testing.assert_allclose(near, (144 - 0.1 * f, 96, 144 + 0.1 * f, 96 + 0.15 * f), atol=2.5)
    # The far car reaches from 0.05 to 0.15 of the tangent; up to 0.1 the near one stands before it.
    np.testing.assert_allclose(far, (144 + 0.1 * f, 96, 144 + 0.15 * f, 96 + 0.075 * f), atol=2.5)


def test_visibility_is_the_share_that_nothing_hides(both):
    assert both["near"].visibility == pytest.approx(1.0, abs=0.02)
    assert both["far"].visibility == pytest.approx(0.5, abs=0.1)
    assert not (both["near"].mask & both["far"].mask).any()


def test_distance_and_size_are_in_metres(both):
    assert both["near"].distance_m == pytest.approx(np.hypot(NEAR_M, 0.75), abs=1e-6)
    assert both["far"].center_m == pytest.approx([2.0, 0.75, FAR_M])
    scaled = replace(boxy_scene(), metres_per_unit=2.0)
    doubled = seen(scaled, camera_of(scaled))["near"]
    assert doubled.size_lwh_m == (8.0, 4.0, 3.0)
    assert doubled.distance_m == pytest.approx(2 * both["near"].distance_m)


def test_what_leaves_the_picture_is_truncated():
    scene = boxy_scene()
    camera = camera_of(scene)
    cut = seen(scene, replace(camera, cx=camera.cx - 144.0))["near"]
    assert cut.truncation == pytest.approx(0.5, abs=0.1)
    assert cut.visibility == pytest.approx(1.0, abs=0.02)  # the picture's edge hides nothing
    assert cut.box_xyxy[0] == 0.0
    assert "near" not in seen(scene, replace(camera, cx=camera.cx - 400.0))


def test_what_is_hidden_by_a_person_is_not_there():
    scene = boxy_scene()
    count = len(scene.actors[0].gaussians)
    without = scene.with_member("actors/near", marks=SelectionFlags(hidden=BitMask.all(count)))
    assert list(seen(without)) == ["far"]
    assert seen(without)["far"].visibility == pytest.approx(1.0, abs=0.02)
    assert list(seen(scene.with_member("actors/near", visible=False))) == ["far"]
