"""What a HUGSIM client is sent for an observation: `(obs, info)`, named and shaped as HUGSIM's env has them."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from jaxtyping import UInt8

from gsrain_engine.scene.scene import RigCamera

from ..agents.lidar_mount import lidar_to_rig
from ..agents.observation import COMMANDS, CameraView, Observation, Rig
from .axes import HugsimWorld
from .setting import CAMERA_NAMES

ChannelOrder = Literal["rgb", "bgr"]
_UNKNOWN = 19
"""The class after Cityscapes' last: HUGSIM's scenes know twenty."""
_ROUTE_SHARE = 0.9
"""HUGSIM's route is complete at nine tenths."""


def hugsim_obs(
    views: Mapping[str, CameraView], cameras: Mapping[str, RigCamera], channels: ChannelOrder, semantic: bool,
    depth: bool,
) -> dict[str, dict[str, np.ndarray]]:  # fmt: skip
    """Return `obs`: rgb, semantic and depth (metres) by camera; all zeros for a camera that nothing was drawn for.

    What is not sent is an empty dictionary, so that a client that wants it after all stops at a missing name and not
    at a picture that is not one.
    """
    rgb: dict[str, np.ndarray] = {}
    semantics: dict[str, np.ndarray] = {}
    depths: dict[str, np.ndarray] = {}
    for name, camera in cameras.items():
        view, shape = views.get(name), (camera.height, camera.width)
        rgb[name] = np.zeros((*shape, 3), np.uint8) if view is None else _ordered(view.image, channels)
        if semantic:
            ids = None if view is None else view.semantic
            semantics[name] = np.zeros(shape, np.uint8) if ids is None else np.minimum(ids, np.uint8(_UNKNOWN))
        if depth:
            seen = None if view is None else view.depth_m
            depths[name] = np.zeros(shape, np.float32) if seen is None else seen
    return {"rgb": rgb, "semantic": semantics, "depth": depths}


def hugsim_info(
    observation: Observation, rig: Rig, world: HugsimWorld, cameras: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Return `info`; `cameras` are `cam_params`.

    Angles are radians, right positive, but for the boxes' yaw. Two differences, for the client's good: `ego_rot` stays
    (0, yaw, 0) beyond a quarter turn, where HUGSIM's three angles fold over to another triple of the same rotation; and
    every message has `rc` and `collision`, which HUGSIM leaves out of a drive's first.
    """
    state = observation.state
    yaw = world.yaw(state.yaw_rad)
    along = observation.route.nearest(state.x_m, state.y_m).along_m
    return {
        "ego_pos": [float(each) for each in world.ego_place(rig, observation)],
        "ego_rot": [0.0, yaw, 0.0],
        "ego_velo": float(state.speed_m_s),
        "ego_steer": -float(state.steer_rad),
        "accelerate": float(observation.acceleration_m_s2),
        "steer_rate": -float(observation.steer_rate_rad_s),
        "timestamp": float(observation.time_s),
        "command": COMMANDS.index(observation.command),
        "ego_box": world.ego_box(rig, observation),
        "obj_boxes": [world.object_box(user) for user in observation.road_users],
        "cam_params": {name: dict(values) for name, values in cameras.items()},
        "rc": max(0.0, along) / (_ROUTE_SHARE * observation.route.length_m),
        "collision": False,
    }


def camera_params(cameras: Mapping[str, RigCamera], rig: Rig) -> dict[str, dict[str, Any]]:
    """Return `cam_params`: intrinsics, and poses of the vehicle (v2c) and the lidar (l2c) in each camera (4x4, metres).

    The vehicle's frame is nuScenes' (x forward, y left, z up, below the rear axle on the road), the lidar's is x right,
    y forward, z up. The fields of view stand for the focal lengths, W / (2 tan(fovx / 2)), wherever cx and cy are.
    """
    vehicle_to_rig = np.eye(4)
    vehicle_to_rig[2, 3] = -rig.height_m
    lidar = lidar_to_rig(cameras[CAMERA_NAMES[0]])
    params: dict[str, dict[str, Any]] = {}
    for name, camera in cameras.items():
        rig_to_camera = np.linalg.inv(camera.camera_to_ego)
        params[name] = {
            "intrinsic": {
                "H": int(camera.height), "W": int(camera.width), "cx": float(camera.cx), "cy": float(camera.cy),
                "fovx": float(2 * np.arctan(camera.width / (2 * camera.fx))),
                "fovy": float(2 * np.arctan(camera.height / (2 * camera.fy))),
            },
            "v2c": rig_to_camera @ vehicle_to_rig,
            "l2c": rig_to_camera @ lidar,
        }  # fmt: skip
    return params


def _ordered(image: UInt8[np.ndarray, "h w 3"], channels: ChannelOrder) -> UInt8[np.ndarray, "h w 3"]:
    return image if channels == "rgb" else np.ascontiguousarray(image[..., ::-1])
