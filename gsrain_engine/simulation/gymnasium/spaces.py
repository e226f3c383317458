"""Action and observation spaces of the Gymnasium environments."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from jaxtyping import Float32, Float64

from ...scene.scene import RigCamera
from ..agents.base import COMMANDS, Observation, SensorRequirements
from ..geometry import wrap_angle
from ..traffic.base import RoadUser
from ..vehicle import Control, Vehicle, VehicleState, yaw_rate

PLAN_POINTS = 6
"""Number of points of a plan, 0.5 s apart: three seconds, as in UniAD."""

_REACH_M = 200.0


def control_space() -> spaces.Box:
    """Return the space of controls: acceleration and steering rate as shares of the vehicle's limits.

    Shape (2,), -1..1: from full braking to full acceleration, and from full rate right to full rate left.
    """
    return spaces.Box(-1.0, 1.0, (2,), np.float32)


def plan_space() -> spaces.Box:
    """Return the space of plans: points in the vehicle's frame, (6, 2) meters (x forward, y left), 0.5 s apart."""
    return spaces.Box(-_REACH_M, _REACH_M, (PLAN_POINTS, 2), np.float32)


def control_of(action: Float64[np.ndarray, "2"], vehicle: Vehicle) -> Control:
    pedal, wheel = (float(each) for each in np.clip(action, -1.0, 1.0))
    most = vehicle.most_acceleration_m_s2 if pedal > 0 else vehicle.most_braking_m_s2
    return Control(pedal * most, wheel * vehicle.most_steer_rate_rad_s)


# Observations

ROUTE_POINTS, ROUTE_STEP_M = 30, 2.0
MAX_ROAD_USERS = 16
_FAR_M = 10_000.0
_EGO = np.array([200.0, 100.0, 2.0, 20.0, 100.0, 1000.0, np.pi], np.float32)
_USER = np.array([_FAR_M, _FAR_M, np.pi, 100.0, 100.0, 100.0, 200.0], np.float32)


def observation_space(cameras: Sequence[RigCamera], needs: SensorRequirements) -> spaces.Space[dict[str, Any]]:
    """Return the space of observations.

    ego: (7,) speed m/s, acceleration m/s2, steering rad, steering rate rad/s, yaw rate rad/s, distance left of the
        route m, heading left of the route's rad.
    command: 0 right, 1 left, 2 straight.
    route: (30, 2) points of the route, 2 m apart, from 2 m ahead on, in the vehicle's frame (x forward, y left).
    road_users: (16, 7) nearest first: x and y of the center and heading in the vehicle's frame, length, width,
        height, speed; zeros in unused rows. Ground truth: ignore it when testing cameras.
    road_user_count: number of used rows of `road_users`.
    rgb, depth, semantic: by camera (h, w, 3) uint8; (h, w) float32 m, 0 where there is nothing; (h, w) uint8 of
        Cityscapes' training ids. Each only if requested.
    """
    room: dict[str, spaces.Space[Any]] = {
        "ego": spaces.Box(-_EGO, _EGO, dtype=np.float32),
        "command": spaces.Discrete(len(COMMANDS)),
        "route": spaces.Box(-_FAR_M, _FAR_M, (ROUTE_POINTS, 2), np.float32),
        "road_users": _bounded(np.tile(_USER, (MAX_ROAD_USERS, 1))),
        "road_user_count": spaces.Discrete(MAX_ROAD_USERS + 1),
    }
    if cameras:
        room["rgb"] = _by_camera(cameras, 255, (3,), np.uint8)
        if needs.depth:
            room["depth"] = _by_camera(cameras, _FAR_M, (), np.float32)
        if needs.semantic:
            room["semantic"] = _by_camera(cameras, 255, (), np.uint8)
    return spaces.Dict(room)


def observation_values(observation: Observation, vehicle: Vehicle) -> dict[str, Any]:
    """Return an observation as values of the space, clipped to its bounds."""
    state = observation.state
    count, users = _road_users(state, observation.road_users)
    found: dict[str, Any] = {
        "ego": _ego(observation, vehicle),
        "command": COMMANDS.index(observation.command),
        "route": _within(_route(observation), np.float32(_FAR_M)),
        "road_users": users,
        "road_user_count": count,
    }
    views = observation.views
    if views:
        found["rgb"] = {name: view.image for name, view in views.items()}
    depths = {name: np.minimum(view.depth_m, _FAR_M) for name, view in views.items() if view.depth_m is not None}
    semantics = {name: view.semantic for name, view in views.items() if view.semantic is not None}
    return found | ({"depth": depths} if depths else {}) | ({"semantic": semantics} if semantics else {})


def _ego(observation: Observation, vehicle: Vehicle) -> Float32[np.ndarray, "7"]:
    state, route = observation.state, observation.route
    on = route.nearest(state.x_m, state.y_m)
    turned = wrap_angle(state.yaw_rad - route.at(on.along_m)[2])
    values = (
        state.speed_m_s, observation.acceleration_m_s2, state.steer_rad, observation.steer_rate_rad_s,
        yaw_rate(vehicle, state), on.left_m, turned,
    )  # fmt: skip
    return _within(np.array(values), _EGO)


def _route(observation: Observation) -> Float64[np.ndarray, "n 2"]:
    state, route = observation.state, observation.route
    along = route.nearest(state.x_m, state.y_m).along_m
    ahead = along + ROUTE_STEP_M * np.arange(1, ROUTE_POINTS + 1)
    return state.from_world(np.array([route.at(float(each))[:2] for each in ahead]))


def _road_users(state: VehicleState, users: Sequence[RoadUser]) -> tuple[int, Float32[np.ndarray, "users 7"]]:
    """Return the number of road users and the rows of the nearest."""
    rows = np.zeros((MAX_ROAD_USERS, len(_USER)), np.float32)
    if not users:
        return 0, rows
    places = state.from_world(np.array([(user.x_m, user.y_m) for user in users]))
    nearest = np.argsort(np.linalg.norm(places, axis=1), kind="stable")[:MAX_ROAD_USERS]
    for row, i in enumerate(nearest):
        user = users[i]
        turned = wrap_angle(user.yaw_rad - state.yaw_rad)
        rows[row] = _within(np.array([*places[i], turned, *user.size_lwh, user.speed_m_s]), _USER)
    return len(nearest), rows


def _within(values: Float64[np.ndarray, "..."], most: Any) -> Float32[np.ndarray, "..."]:
    return np.clip(values.astype(np.float32), -most, most)


def _bounded(most: Float32[np.ndarray, "..."]) -> spaces.Box:
    return spaces.Box(-most, most, dtype=np.float32)


def _by_camera(cameras: Sequence[RigCamera], most: float, channels: tuple[int, ...], kind: Any) -> spaces.Space[Any]:
    return spaces.Dict({
        camera.name: spaces.Box(0, most, (camera.height, camera.width, *channels), kind) for camera in cameras
    })  # fmt: skip
