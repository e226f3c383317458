"""Agent protocol, observations and plans, the constant-velocity agent, and lane paths."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, Float64, UInt8, UInt16

from ...scene.camera import Camera
from ...scene.scene import RigCamera
from ..geometry import Route
from ..traffic.base import RoadUser
from ..vehicle import Vehicle, VehicleState

SPACING_S = 0.5  # time between the points of a plan, and from now to the first point
FARTHEST_M = 10_000.0  # maximum reach of a plan; plans with farther points are rejected


@dataclass(frozen=True, slots=True)
class SensorRequirements:
    """Sensor data that an agent requires; nothing else is rendered."""

    cameras: tuple[str, ...] = ()
    """Camera names; ("all",) selects all of the rig, ("front",) the most forward-facing one."""
    depth: bool = False
    semantic: bool = False


NOTHING = SensorRequirements()


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Plan of an agent."""

    points: Float64[np.ndarray, "n 2"]
    """Positions 0.5 s, 1.0 s, ... from now, in the vehicle's current frame (x forward, y left, meters)."""
    notes: dict[str, Any] = field(default_factory=dict[str, Any])
    """Plain values for the record, such as detections and reasons."""


# Observations


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Constants of a drive: the vehicle and the cameras of the agent."""

    vehicle: Vehicle
    cameras: tuple[RigCamera, ...]
    """Cameras in the rig frame (x forward, y left, z up, origin above the rear axle), at image size."""
    height_m: float
    """Height of the rig frame's origin above the road."""


Command = Literal["right", "left", "straight"]


@dataclass(frozen=True, slots=True, eq=False)
class CameraView:
    """Image of one camera."""

    image: UInt8[np.ndarray, "h w 3"]
    """RGB, display-referred."""
    camera: Camera
    """World frame, meters."""
    depth_m: Float32[np.ndarray, "h w"] | None = None
    """Depth along the optical axis without rain, 0 where empty. None if not requested."""
    semantic: UInt8[np.ndarray, "h w"] | None = None
    """Cityscapes' training ids (0 road, 1 sidewalk, 2 building, 8 vegetation, 10 sky, 13 car, ...; 255 unknown)."""
    instances: UInt16[np.ndarray, "h w"] | None = None
    """1 for the first of the observation's road users, 2 for the second, ...; 0 for everything else."""


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """Observation at one step. World frame: meters, z up, seconds since the scenario began."""

    step: int
    time_s: float
    state: VehicleState
    acceleration_m_s2: float
    steer_rate_rad_s: float
    """Acceleration and steering rate are those over the previous step."""
    height_m: float
    """Height of the ground below the ego vehicle."""
    command: Command
    """Direction at the next intersection."""
    views: Mapping[str, CameraView]
    route: Route
    road_users: tuple[RoadUser, ...]
    """Ground-truth road users, for oracles, labels and displays. Camera agents must not use them."""

    def route_ahead(self, reach_m: float = 60.0, step_m: float = 1.0) -> Float64[np.ndarray, "n 2"]:
        """Return the route from the current position on, in the vehicle's frame (x forward, y left)."""
        along = self.route.nearest(self.state.x_m, self.state.y_m).along_m
        return self.state.from_world(self.route.ahead(along, reach_m, step_m))


@runtime_checkable
class Agent(Protocol):
    """A driver under test. The same seed and observations give the same plans."""

    @property
    def name(self) -> str:
        """Name in tables and roll-outs."""
        ...

    @property
    def needs(self) -> SensorRequirements:
        """Required sensor data."""
        ...

    def reset(self, seed: int, rig: Rig) -> None:
        """Start a drive and forget the previous one."""

    def plan(self, observation: Observation) -> Trajectory | None:
        """Return a plan; None ends the drive."""

    def close(self) -> None:
        """Release resources; the agent is not used again."""


COMMANDS: tuple[Command, ...] = ("right", "left", "straight")
"""In nuScenes' numbering, which UniAD, HUGSIM and NeuroNCAP share: 0, 1, 2."""

# Virtual lidar frame: camera-only stacks still use it as their reference

FROM_FRONT_CAMERA_M = (-0.76, -0.02, 0.33)
"""Position of nuScenes' LIDAR_TOP relative to its CAM_FRONT, in vehicle axes (x forward, y left, z up):
sample log of 2018-07-24, to a centimeter; HUGSIM's `l2c` of its CAM_FRONT agrees to two centimeters."""


def front_camera(cameras: tuple[RigCamera, ...]) -> RigCamera:
    """Return the most forward-facing camera."""
    return max(cameras, key=lambda each: each.camera_to_ego[0, 2])


def lidar_to_rig(front: RigCamera) -> Float64[np.ndarray, "4 4"]:
    """Return the pose of the lidar (x right, y forward, z up) in the rig frame (x forward, y left, z up), meters."""
    pose = np.eye(4)
    # From lidar axes (x right, y forward, z up) to rig axes (x forward, y left, z up).
    pose[:3, :3] = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    pose[:3, 3] = front.camera_to_ego[:3, 3] + FROM_FRONT_CAMERA_M
    return pose


# Constant-velocity agent


class ConstantVelocityAgent:
    """Follows the route at its current speed and never brakes; a baseline."""

    name = "constant-velocity"
    needs = SensorRequirements()

    def reset(self, seed: int, rig: Rig) -> None:
        """Do nothing."""

    def plan(self, observation: Observation) -> Trajectory:
        state = observation.state
        along = observation.route.nearest(state.x_m, state.y_m).along_m
        distances = along + state.speed_m_s * SPACING_S * np.arange(1, 7)
        return Trajectory(state.from_world(np.array([observation.route.at(float(s))[:2] for s in distances])))

    def close(self) -> None:
        """Do nothing."""


# Lane path: follows the route and returns smoothly to it from a lateral offset; world frame, meters

_SHORTEST_RETURN_M, _RETURN_S = 6.0, 1.5
"""Decay length of the lateral offset (to 1/e): the larger of a distance and a time at the current speed. At 10 m/s
and an offset of 1 m the lateral acceleration is 0.4 m/s2, which is comfortable."""


class PathCoordinates(NamedTuple):
    """Distance along the route from the vehicle's rear axle, and offset from the path, left positive."""

    ahead_m: float
    left_m: float


_CLEARANCE_M = 0.25  # lateral clearance of a car; streets with parked cars leave half a meter


def half_corridor_m(vehicle: Vehicle) -> float:
    """Return half the width of the corridor that a vehicle needs."""
    return vehicle.width_m / 2 + _CLEARANCE_M


@dataclass(frozen=True, slots=True, eq=False)
class LanePath:
    """The path of one step; it starts at the vehicle's rear axle."""

    state: VehicleState
    route: Route
    along_m: float
    """Position of the vehicle along its route."""
    left_m: float
    """Lateral offset of the vehicle from its route, left positive."""

    @classmethod
    def of(cls, state: VehicleState, route: Route) -> "LanePath":
        on_route = route.nearest(state.x_m, state.y_m)
        return cls(state, route, on_route.along_m, on_route.left_m)

    def points(self, distances_m: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2"]:
        """Return the points at given distances in the vehicle's frame (x forward, y left); (0, 0) at distance 0."""
        start = self.route.at(self.along_m, self.left_m)[:2]
        there = [self.route.at(self.along_m + float(s), self._offset_at(float(s)))[:2] for s in distances_m]
        # In bends a laterally offset point and its nearest route point differ slightly; the vehicle stays the start.
        away = np.array(there).reshape(-1, 2) - start + (self.state.x_m, self.state.y_m)
        return self.state.from_world(away)

    def place(self, x_m: float, y_m: float) -> PathCoordinates:
        """Return the position of a world point relative to the path."""
        on_route = self.route.nearest(x_m, y_m)
        ahead = on_route.along_m - self.along_m
        return PathCoordinates(ahead, on_route.left_m - self._offset_at(max(ahead, 0.0)))

    def _offset_at(self, ahead_m: float) -> float:
        reach = max(_SHORTEST_RETURN_M, _RETURN_S * self.state.speed_m_s)
        return self.left_m * float(np.exp(-ahead_m / reach))
