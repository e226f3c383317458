from dataclasses import replace

import numpy as np
import pytest

from gsrain_engine.recolor.views import ground_height_m, ground_share
from gsrain_engine.scene.camera import Camera, look_at
from gsrain_engine.scene.scene import Scene
from training.small_street import small_street

CAMERA = Camera.from_fov(60, 48, 60, look_at(np.array([0, 0, 1.5]), np.array([1.0, 0, 1.4]), np.array([0.0, 0, 1])))
FLAT = np.zeros((48, 60), np.float32)


def test_ground_is_what_the_scene_says_or_what_lies_low():
    scene = small_street()
    assert ground_height_m(replace(scene, ground_m=-2.0)) == -2
    assert ground_height_m(replace(scene, ground_m=None)) == pytest.approx(0, abs=0.01)
    assert ground_height_m(Scene("empty")) == 0


def test_only_what_is_low_and_faces_up_is_ground():
    depth = FLAT + np.float32(4)  # at the lower edge, 35 degrees down, that is 2.9 m below the eye
    assert ground_share(depth, FLAT + 1, CAMERA, -1.4)[-1, 30] > 0.9
    assert ground_share(depth, FLAT + 1, CAMERA, -3.0)[-1, 30] == 0
    assert not ground_share(FLAT, FLAT + 1, CAMERA, -1.4).any()
    assert not ground_share(depth, FLAT + np.float32(0.5), CAMERA, -1.4).any()
