"""Names, shapes, units and frames of what a HUGSIM client is sent."""

import numpy as np
import pytest

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.street.build import street_rigs
from gsrain_engine.simulation.agents.base import CameraView, Observation, Rig
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.interop.hugsim_protocol import (
    CAMERA_NAMES,
    HugsimWorld,
    camera_params,
    hugsim_info,
    hugsim_obs,
    hugsim_rig,
    six_hugsim_cameras,
)
from gsrain_engine.simulation.traffic.base import RoadUser
from gsrain_engine.simulation.vehicle import HUGSIM_VEHICLE, VehicleState

RIG = Rig(HUGSIM_VEHICLE, hugsim_rig(street_rigs()["nuscenes"]), 1.5)
SIX = six_hugsim_cameras(RIG.cameras)
CAMERA = Camera(800, 450, 600.0, 600.0, 400.0, 225.0)


def view(**more):
    image = np.zeros((450, 800, 3), np.uint8)
    image[..., 0] = 200
    return CameraView(image, CAMERA, **more)


def seen(**fields):
    values = {
        "step": 3, "time_s": 0.75, "state": VehicleState(4.0, 0.5, -0.2, 7.0, 0.1), "acceleration_m_s2": -1.5,
        "steer_rate_rad_s": 0.3, "height_m": 0.0, "command": "left", "views": {},
        "route": Route(np.array([[0.0, 0.0], [100.0, 0.0]])),
        "road_users": (RoadUser("a", "car", (4.0, 2.0, 1.5), 20.0, 0.0, 0.0),),
    }  # fmt: skip
    return Observation(**{**values, **fields})


def info(observation):
    world = HugsimWorld(0.0, 0.0, 1.51, 0.0)
    return hugsim_info(observation, RIG, world, camera_params(SIX, RIG))


def test_info_has_hugsims_names_and_signs():
    sent = info(seen())
    assert set(sent) == {
        "ego_pos", "ego_rot", "ego_velo", "ego_steer", "accelerate", "steer_rate", "timestamp", "command", "ego_box",
        "obj_boxes", "cam_params", "rc", "collision",
    }  # fmt: skip
    np.testing.assert_allclose(sent["ego_pos"], (-0.5, 0, 4), atol=1e-12)  # 0.5 m left is -0.5 to the right
    np.testing.assert_allclose(sent["ego_rot"], (0, 0.2, 0))  # right positive
    assert (sent["ego_velo"], sent["ego_steer"], sent["accelerate"], sent["steer_rate"]) == (7.0, -0.1, -1.5, -0.3)
    assert (sent["timestamp"], sent["command"], sent["collision"]) == (0.75, 1, False)
    assert sent["rc"] == pytest.approx(4 / 90)
    assert len(sent["obj_boxes"]) == 1 and len(sent["obj_boxes"][0]) == 7


@pytest.mark.parametrize(("command", "number"), [("right", 0), ("left", 1), ("straight", 2)])
def test_commands_are_numbered_as_stacks_were_trained(command, number):
    assert info(seen(command=command))["command"] == number


def test_fields_of_view_stand_for_focal_lengths():
    for name, params in camera_params(SIX, RIG).items():
        inner = params["intrinsic"]
        assert list(inner) == ["H", "W", "cx", "cy", "fovx", "fovy"]
        assert (inner["H"], inner["W"]) == (450, 800)
        assert 800 / (2 * np.tan(inner["fovx"] / 2)) == pytest.approx(SIX[name].fx)
        assert 450 / (2 * np.tan(inner["fovy"] / 2)) == pytest.approx(SIX[name].fy)
        assert 0 < inner["fovy"] < inner["fovx"] < np.pi  # radians


def test_lidar_and_vehicle_are_where_nuscenes_has_them():
    front = camera_params(SIX, RIG)["CAM_FRONT"]
    # 10 m ahead of the lidar at its height: 0.33 m above the camera, 10 - 0.76 m before it.
    np.testing.assert_allclose(front["l2c"] @ (0, 10, 0, 1), (0.02, -0.33, 9.24, 1), atol=1e-9)
    np.testing.assert_allclose(front["l2c"] @ (2, 0, 0, 1), (2.02, -0.33, -0.76, 1), atol=1e-9)
    # Vehicle frame: x forward, y left, on the road.
    np.testing.assert_allclose(front["v2c"] @ (10, 3, 0, 1), (-3, 1.51, 10, 1), atol=1e-9)
    back = camera_params(SIX, RIG)["CAM_BACK"]
    assert (back["l2c"] @ (0, -10, 0, 1))[2] > 8  # what is behind lies before the back camera


def test_what_is_not_asked_for_is_empty_and_what_is_missing_is_black():
    sent = hugsim_obs({"CAM_FRONT": view()}, SIX, "rgb", semantic=False, depth=False)
    assert list(sent) == ["rgb", "semantic", "depth"]
    assert tuple(sent["rgb"]) == CAMERA_NAMES and sent["semantic"] == {} and sent["depth"] == {}
    assert sent["rgb"]["CAM_FRONT"][0, 0].tolist() == [200, 0, 0]
    assert not sent["rgb"]["CAM_BACK"].any() and sent["rgb"]["CAM_BACK"].shape == (450, 800, 3)


def test_everything_is_sent_when_asked_for():
    depth = np.full((450, 800), 3.5, np.float32)
    semantic = np.full((450, 800), 255, np.uint8)
    semantic[0, 0] = 13
    full = {"CAM_FRONT": view(depth_m=depth, semantic=semantic)}
    sent = hugsim_obs(full, SIX, "rgb", semantic=True, depth=True)
    assert sent["depth"]["CAM_FRONT"][5, 5] == 3.5 and sent["depth"]["CAM_BACK"].dtype == np.float32
    assert sent["semantic"]["CAM_FRONT"][0, 0] == 13
    assert sent["semantic"]["CAM_FRONT"].max() == 19  # HUGSIM knows twenty classes; unknown is its last
    assert sent["semantic"]["CAM_BACK"].dtype == np.uint8 and sent["semantic"]["CAM_BACK"].shape == (450, 800)


def test_blue_first_on_request():
    sent = hugsim_obs({"CAM_FRONT": view()}, SIX, "bgr", semantic=False, depth=False)
    assert sent["rgb"]["CAM_FRONT"][0, 0].tolist() == [0, 0, 200]
    assert sent["rgb"]["CAM_FRONT"].flags.c_contiguous
