"""NeuroNCAP: its baseline agent (Ljungbergh et al. 2024) and the `/infer` messages of its model nodes."""

import base64
import io
import struct
import zipfile
from typing import Any

import msgspec
import numpy as np
from jaxtyping import UInt8

from ...scene.scene import RigCamera
from ..vehicle import yaw_rate
from . import base
from .base import Observation, Rig, Trajectory

_HALF_WIDTH_M, _START_M, _AHEAD_S = 2.5, 2.0, 2.0
_STOP = np.zeros((6, 2))


class NeuroNCAPBaselineAgent:
    """Keeps its speed along the route until the center of a road user is in the corridor ahead, then stops.

    The corridor is straight, 5 m wide, and starts 2 m ahead of the rear axle; its length is two seconds of driving and
    stays fixed from the first stop on. Road users come from the simulator; in the original they come from the model
    under test.
    """

    name = "neuroncap-baseline"
    needs = base.SensorRequirements()

    def __init__(self) -> None:
        self._onward = base.ConstantVelocityAgent()
        self._length_m: float | None = None

    def reset(self, seed: int, rig: Rig) -> None:
        self._length_m = None

    def plan(self, observation: Observation) -> Trajectory:
        """Return points along the route, or six times the current position."""
        state = observation.state
        length = _AHEAD_S * state.speed_m_s if self._length_m is None else self._length_m
        middles = np.array([(user.x_m, user.y_m) for user in observation.road_users]).reshape(-1, 2)
        ahead, left = state.from_world(middles).T
        inside = (ahead >= _START_M) & (ahead <= _START_M + length) & (np.abs(left) <= _HALF_WIDTH_M)
        blocking = [user.id for user, each in zip(observation.road_users, inside, strict=True) if each]
        if not blocking:
            return Trajectory(self._onward.plan(observation).points, {"in_corridor": []})
        self._length_m = length
        return Trajectory(_STOP.copy(), {"in_corridor": blocking})

    def close(self) -> None:
        """Do nothing."""


# `/infer` messages
# Ego frame: x forward, y left, z up, below the rear axle on the road, as in nuScenes. Fields follow neuro-ncap's
# `ModelInput` and the `InferenceInputs` of its UniAD node.

_GRAVITY_M_S2 = 9.8


def neuroncap_message(observation: Observation, rig: Rig) -> bytes:
    """Return the `/infer` body: images as base64 tensors, pose, bus signals, microseconds, command, calibration."""
    pictures = {name: base64.b64encode(tensor_file(view.image)).decode() for name, view in observation.views.items()}
    cameras = [each for each in rig.cameras if each.name in observation.views]
    message = {
        "images": pictures,
        "ego2world": observation.state.rig_to_world(0.0).tolist(),
        "canbus": can_bus(observation, rig),
        "timestamp": round(1e6 * observation.time_s),
        "command": base.COMMANDS.index(observation.command),
        "calibration": _calibration(cameras, rig),
    }
    return msgspec.json.encode(message)


def can_bus(observation: Observation, rig: Rig) -> list[float]:
    """Return nuScenes' sixteen bus signals.

    Position (m; z is 0 as in NeuroNCAP), orientation (wxyz), acceleration (m/s2, gravity upward), turn rates (rad/s)
    and velocity (m/s), the last three in the ego frame.
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
        "lidar2ego": (rig_to_ego @ base.lidar_to_rig(base.front_camera(rig.cameras))).tolist(),
    }


# PyTorch tensor files, written without PyTorch
# An uncompressed zip archive with a pickle that rebuilds the tensor and its bytes (zip-based format of `torch.save`
# since PyTorch 1.6).


def tensor_file(image: UInt8[np.ndarray, "h w c"]) -> bytes:
    """Return the file of a byte tensor (H, W, C) for `torch.load`; the same image gives the same bytes."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, data in (
            ("data.pkl", _rebuilding(image.shape)),
            ("data/0", np.ascontiguousarray(image).tobytes()),
            ("version", b"3\n"),
        ):
            archive.writestr(zipfile.ZipInfo(f"archive/{name}"), data)
    return stream.getvalue()


def _rebuilding(shape: tuple[int, ...]) -> bytes:
    """Return a hand-written pickle of the call that builds a contiguous CPU tensor from storage 0."""
    height, width, channels = shape
    count = height * width * channels
    storage = b"(" + _text("storage") + b"ctorch\nByteStorage\n" + _text("0") + _text("cpu") + _number(count) + b"t"
    return b"".join((
        b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n(", storage, b"Q", _number(0),
        b"(" + _number(height) + _number(width) + _number(channels) + b"t",
        b"(" + _number(width * channels) + _number(channels) + _number(1) + b"t",
        b"\x89", b"ccollections\nOrderedDict\n)R", b"tR.",
    ))  # fmt: skip


def _text(text: str) -> bytes:
    return b"X" + struct.pack("<I", len(text)) + text.encode("ascii")


def _number(number: int) -> bytes:
    return b"J" + struct.pack("<i", number)
