"""The camera that goes along with a drive."""

import numpy as np
import pytest

from gsrain_engine.editor.drive import RolloutInScene
from gsrain_engine.editor.viewport.camera import OrbitCamera
from gsrain_engine.editor.viewport.camera_follow import ChaseCamera
from gsrain_engine.simulation.sensors import placed_camera

from .driven import driven


@pytest.fixture
def shown():
    scene, rollout = driven(start_s=0.5)
    return RolloutInScene(rollout, scene)


def test_behind_is_8_m_back_and_3_m_up_and_goes_along(shown):
    chase, navigation = ChaseCamera(), OrbitCamera()
    chase.begin("behind")
    chase.ride(shown.vehicle(0.5), navigation)
    ego = shown.played.state(0.0)
    assert navigation.position == pytest.approx((ego.x_m - 8, ego.y_m, 3.0), abs=0.01)
    assert navigation.heading == pytest.approx(0.0)
    assert navigation.pitch < 0
    navigation.turn(0.3, 0.0)  # a person looks around
    chase.ride(shown.vehicle(1.5), navigation)
    assert navigation.position == pytest.approx((ego.x_m - 8 + 2.0, ego.y_m, 3.0), abs=0.01)
    assert navigation.heading == pytest.approx(0.3)
    assert chase.velocity_m_s == pytest.approx((2.0, 0, 0), abs=1e-3)


def test_the_front_camera_is_that_of_the_rig(shown):
    chase, navigation = ChaseCamera(), OrbitCamera()
    chase.begin("front camera")
    chase.ride(shown.vehicle(1.0), navigation)
    camera = placed_camera(shown.front_camera, shown.played.rig_to_world(0.5))
    seen = navigation.camera(camera.width, camera.height)
    assert np.allclose(seen.world_to_camera, camera.world_to_camera, atol=1e-9)
    assert seen.fy == pytest.approx(camera.fy)
    chase.let_go()
    assert chase.mode == "free"
    chase.ride(shown.vehicle(1.2), navigation)
    assert np.allclose(navigation.camera(camera.width, camera.height).world_to_camera, camera.world_to_camera)
    assert chase.velocity_m_s is None


def test_after_the_end_it_stays_there(shown):
    chase, navigation = ChaseCamera(), OrbitCamera()
    chase.begin("behind")
    chase.ride(shown.vehicle(1e3), navigation)
    assert navigation.position[0] == pytest.approx(shown.played.state(1e3).x_m - 8)
