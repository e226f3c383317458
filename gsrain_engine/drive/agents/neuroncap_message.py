"""What NeuroNCAP's model nodes are asked with: `/infer`'s JSON, named and framed as NeuroNCAP sends it.

Ego frame: x forward, y left, z up, below the rear axle on the road, as nuScenes has it. Fields: neuro-ncap's
`ModelInput` and the `InferenceInputs` of its UniAD node.
"""

import base64
from typing import Any

import msgspec
import numpy as np

from gsrain_engine.scene.scene import RigCamera

from ..vehicle.bicycle import yaw_rate
from .lidar_mount import front_camera, lidar_to_rig
from .observation import COMMANDS, Observation, Rig
from .tensor_file import tensor_file

_GRAVITY_M_S2 = 9.8


def neuroncap_message(observation: Observation, rig: Rig) -> bytes:
    """Return `/infer`'s body: pictures as tensors in base64, pose, bus signals, microseconds, command, calibration."""
    pictures = {name: base64.b64encode(tensor_file(view.image)).decode() for name, view in observation.views.items()}
    shown = [each for each in rig.cameras if each.name in observation.views]
    message = {
        "images": pictures,
        "ego2world": observation.state.rig_to_world(0.0).tolist(),
        "canbus": can_bus(observation, rig),
        "timestamp": round(1e6 * observation.time_s),
        "command": COMMANDS.index(observation.command),
        "calibration": _calibration(shown, rig),
    }
    return msgspec.json.encode(message)


def can_bus(observation: Observation, rig: Rig) -> list[float]:
    """Return nuScenes' sixteen bus signals.

    Place (m; 0 high, as NeuroNCAP's), orientation (wxyz), acceleration (m/s2, gravity upward), turn rates (rad/s) and
    velocity (m/s), the last three in the ego frame.
    """
    state = observation.state
    turning = yaw_rate(rig.vehicle, state)
    half = state.yaw_rad / 2
    signals = (
        state.x_m, state.y_m, 0.0, np.cos(half), 0.0, 0.0, np.sin(half),
        observation.acceleration_m_s2, state.speed_m_s * turning, _GRAVITY_M_S2,
        0.0, 0.0, turning, state.speed_m_s, 0.0, 0.0,
    )  # fmt: skip
    return [float(each) for each in signals]


def _calibration(cameras: list[RigCamera], rig: Rig) -> dict[str, Any]:
    rig_to_ego = np.eye(4)
    rig_to_ego[2, 3] = rig.height_m
    return {
        "camera2image": {
            each.name: [[each.fx, 0.0, each.cx], [0.0, each.fy, each.cy], [0.0, 0.0, 1.0]] for each in cameras
        },
        "camera2ego": {each.name: (rig_to_ego @ each.camera_to_ego).tolist() for each in cameras},
        "lidar2ego": (rig_to_ego @ lidar_to_rig(front_camera(rig.cameras))).tolist(),
    }
