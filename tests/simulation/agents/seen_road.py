"""A straight road as a camera agent is shown it: where boxes of cars are in its pictures is worked out, not drawn."""

import numpy as np

from gsrain_engine.evaluation.detection.detector import Detection
from gsrain_engine.scene.camera import Camera
from gsrain_engine.simulation.agents.base import CameraView, Observation, Rig
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.traffic.base import RoadUser
from gsrain_engine.simulation.vehicle import Vehicle, VehicleState

VEHICLE = Vehicle()
FRONT_M = 3.6
"""From its rear axle to its front bumper."""
GROUND_M = 7.0
ROUTE = Route(np.array([[0.0, 0.0], [300.0, 0.0]]))
_MOUNT_M, _ABOVE_M = 1.5, 2.0
_AHEAD = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])


def state(x_m=0.0, speed_m_s=10.0, left_m=0.0):
    """An ego vehicle that goes along the road."""
    return VehicleState(x_m, left_m, 0.0, speed_m_s)


def camera(of, pitch_rad=0.0):
    """A front camera 1.5 m ahead of the rear axle and 2 m above the road, 800 px wide."""
    cosine, sine = np.cos(pitch_rad), np.sin(pitch_rad)
    down = np.array([[1.0, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    matrix = np.eye(4)
    matrix[:3, :3] = down @ _AHEAD
    matrix[:3, 3] = -matrix[:3, :3] @ (of.x_m + _MOUNT_M, of.y_m, GROUND_M + _ABOVE_M)
    return Camera(800, 534, 858.0, 858.0, 399.0, 267.0, matrix)


def rear_box(of, gap_m, left_m=0.0, width_m=1.8, overhang_m=0.8, pitch_rad=0.0):
    """The box of a car's rear in the picture, cut at its edges: its sides by the bumper, its bottom by the tyres."""
    seen = camera(of, pitch_rad)
    bumper = of.x_m + FRONT_M + gap_m
    places = [
        (bumper, left_m + width_m / 2, 1.4),
        (bumper, left_m - width_m / 2, 1.4),
        (bumper + overhang_m, left_m, 0),
    ]
    pixels = []
    for x, y, z in places:
        right, down, depth = seen.world_to_camera[:3] @ (x, y, GROUND_M + z, 1.0)
        pixels.append((right / depth * seen.fx + seen.cx, down / depth * seen.fy + seen.cy))
    (left, top), (right, _), (_, bottom) = pixels
    return tuple(float(np.clip(v, 0, high)) for v, high in zip((left, top, right, bottom), (800, 534) * 2, strict=True))


def seen_car(of, gap_m, confidence=0.8, class_name="car", **place):
    """A perfect detector's box of a car."""
    return Detection(class_name, confidence, rear_box(of, gap_m, **place))


def observation(of, step=0, users=(), views=1, step_s=0.25):
    """A moment; its pictures show nothing."""
    view = CameraView(np.zeros((534, 800, 3), np.uint8), camera(of))
    return Observation(
        step, step * step_s, of, 0.0, 0.0, GROUND_M, "straight", {f"C{i}": view for i in range(views)}, ROUTE, users,
    )  # fmt: skip


def car(id, gap_m, of, left_m=0.0, yaw_rad=0.0, speed_m_s=0.0):
    """A road user whose middle is half its length farther than a gap ahead."""
    return RoadUser(id, "car", (4.6, 1.8, 1.4), of.x_m + FRONT_M + gap_m + 2.3, left_m, yaw_rad, speed_m_s, GROUND_M)


RIG = Rig(VEHICLE, (), 1.5)
