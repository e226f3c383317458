"""What drives: an agent sees an observation and says where it wants to be."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, Float64, UInt8, UInt16

from ...scene.camera import Camera
from ...scene.scene import RigCamera
from ..route import Route
from ..traffic.base import RoadUser
from ..vehicle import Vehicle, VehicleState

SPACING_S = 0.5
"""Time between the points of a plan, and from now to the first of them."""

FARTHEST_M = 10_000.0
"""A plan that reaches farther is none."""


@dataclass(frozen=True, slots=True)
class SensorRequirements:
    """What an agent must be shown: nothing is drawn that nobody looks at."""

    cameras: tuple[str, ...] = ()
    """By name; ("all",) are all of the rig, ("front",) is the one that looks most straight ahead."""
    depth: bool = False
    semantic: bool = False


NOTHING = SensorRequirements()


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """What an agent answers."""

    points: Float64[np.ndarray, "n 2"]
    """Where its vehicle is to be 0.5 s, 1.0 s, ... from now, in its present frame (x forward, y left, metres)."""
    notes: dict[str, Any] = field(default_factory=dict[str, Any])
    """Plain values that it wants on record: what it saw and why it acts so."""


# § What a driving agent is shown at a moment.


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """What does not change during a drive: the vehicle, and the cameras that an agent gets pictures of."""

    vehicle: Vehicle
    cameras: tuple[RigCamera, ...]
    """In the rig frame (x forward, y left, z up, origin above the rear axle), of the size of the pictures."""
    height_m: float
    """Of the rig frame's origin above the road."""


Command = Literal["right", "left", "straight"]


@dataclass(frozen=True, slots=True, eq=False)
class CameraView:
    """A picture of one camera."""

    image: UInt8[np.ndarray, "h w 3"]
    """RGB, as a screen shows it."""
    camera: Camera
    """In the world, metres."""
    depth_m: Float32[np.ndarray, "h w"] | None = None
    """Along the optical axis, 0 where there is nothing; the scene's own, without rain. None where nobody asked."""
    semantic: UInt8[np.ndarray, "h w"] | None = None
    """Cityscapes' training ids (0 road, 1 sidewalk, 2 building, 8 vegetation, 10 sky, 13 car, ...; 255 unknown)."""
    instances: UInt16[np.ndarray, "h w"] | None = None
    """1 for the first of the observation's road users, 2 for the second, ...; 0 for everything else."""


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A moment of a drive. World frame: metres, z up, seconds since the scenario began."""

    step: int
    time_s: float
    state: VehicleState
    """Of the ego vehicle."""
    acceleration_m_s2: float
    """Its acceleration over the step before."""
    steer_rate_rad_s: float
    """Its steering rate over the step before."""
    height_m: float
    """Of the ground below it."""
    command: Command
    """Where to go at the next choice."""
    views: Mapping[str, CameraView]
    """By camera; those that the agent needs."""
    route: Route
    """The way to take."""
    road_users: tuple[RoadUser, ...]
    """Who is there, as the simulator knows it. Camera agents must not look: it is for oracles, labels and displays."""

    def route_ahead(self, reach_m: float = 60.0, step_m: float = 1.0) -> Float64[np.ndarray, "n 2"]:
        """Return the way to take in the vehicle's frame (x forward, y left), from where it is now."""
        along = self.route.nearest(self.state.x_m, self.state.y_m).along_m
        return self.state.from_world(self.route.ahead(along, reach_m, step_m))


@runtime_checkable
class Agent(Protocol):
    """A driver under test. The same seed and observations give the same plans."""

    @property
    def name(self) -> str:
        """What tables call it."""
        ...

    @property
    def needs(self) -> SensorRequirements:
        """What it must be shown."""
        ...

    def reset(self, seed: int, rig: Rig) -> None:
        """Begin a drive: forget the one before."""
        ...

    def plan(self, observation: Observation) -> Trajectory | None:
        """Say where to be; None when it can't go on, which ends the drive."""
        ...

    def close(self) -> None:
        """Let go of what it holds; it is not used again."""
        ...


COMMANDS: tuple[Command, ...] = ("right", "left", "straight")
"""In the order of nuScenes' numbers, which UniAD, HUGSIM and NeuroNCAP share: 0, 1, 2."""

# § Where a lidar would stand on a rig: stacks that only see still reckon from there.

FROM_FRONT_CAMERA_M = (-0.76, -0.02, 0.33)
"""Place of nuScenes' LIDAR_TOP as seen from its CAM_FRONT, in vehicle axes (x forward, y left, z up). Sample log of
2018-07-24, to a centimetre; HUGSIM's `l2c` of its CAM_FRONT says the same to two centimetres."""

_AXES = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Lidar axes (x right, y forward, z up) in rig axes (x forward, y left, z up), as columns' images."""


def front_camera(cameras: tuple[RigCamera, ...]) -> RigCamera:
    """Return the camera that looks most straight ahead."""
    return max(cameras, key=lambda each: each.camera_to_ego[0, 2])


def lidar_to_rig(front: RigCamera) -> Float64[np.ndarray, "4 4"]:
    """Return the pose of the lidar (x right, y forward, z up) in the rig frame (x forward, y left, z up), metres."""
    matrix = np.eye(4)
    matrix[:3, :3] = _AXES
    matrix[:3, 3] = front.camera_to_ego[:3, 3] + FROM_FRONT_CAMERA_M
    return matrix


# § The plainest driver: on along the route, as fast as now, whatever comes.

_POINTS = 6


class ConstantVelocityAgent:
    """Keeps its speed and its way: what happens where nobody brakes."""

    name = "constant-velocity"
    needs = SensorRequirements()

    def reset(self, seed: int, rig: Rig) -> None:
        """Begin a drive."""

    def plan(self, observation: Observation) -> Trajectory:
        state = observation.state
        along = observation.route.nearest(state.x_m, state.y_m).along_m
        distances = along + state.speed_m_s * SPACING_S * np.arange(1, _POINTS + 1)
        return Trajectory(state.from_world(np.array([observation.route.at(float(s))[:2] for s in distances])))

    def close(self) -> None:
        """Nothing is held."""


# § The way that an agent means to drive: along its route, back to its middle where it is beside it. World: metres.

_SHORTEST_RETURN_M, _RETURN_S = 6.0, 1.5
"""Of the distance from the route 1/e is left after so many metres, or so many seconds: at 10 m/s and 1 m beside it, a
lateral acceleration of 0.4 m/s2, which nobody minds."""


class PathCoordinates(NamedTuple):
    """Where a place is in relation to a path."""

    ahead_m: float
    """Along the route, from the vehicle's rear axle."""
    left_m: float
    """Of the path."""


@dataclass(frozen=True, slots=True, eq=False)
class LanePath:
    """The path of one moment; it starts where the vehicle's rear axle is."""

    state: VehicleState
    route: Route
    along_m: float
    """Of the vehicle on its route."""
    left_m: float
    """Of the vehicle beside its route."""

    @classmethod
    def of(cls, state: VehicleState, route: Route) -> "LanePath":
        on_route = route.nearest(state.x_m, state.y_m)
        return cls(state, route, on_route.along_m, on_route.left_m)

    def points(self, distances_m: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2"]:
        """Return the points so far ahead, in the vehicle's frame (x forward, y left); (0, 0) at no distance."""
        start = self.route.at(self.along_m, self.left_m)[:2]
        there = [self.route.at(self.along_m + float(s), self._lateral_normal(float(s)))[:2] for s in distances_m]
        # Where a route bends, a place beside it and its nearest point disagree a little: the vehicle stays the start.
        away = np.array(there).reshape(-1, 2) - start + (self.state.x_m, self.state.y_m)
        return self.state.from_world(away)

    def place(self, x_m: float, y_m: float) -> PathCoordinates:
        """Return where a place in the world is in relation to the path."""
        on_route = self.route.nearest(x_m, y_m)
        ahead = on_route.along_m - self.along_m
        return PathCoordinates(ahead, on_route.left_m - self._lateral_normal(max(ahead, 0.0)))

    def heading(self, ahead_m: float) -> float:
        """Return the route's heading in the world so far ahead, in radians."""
        return self.route.at(self.along_m + ahead_m)[2]

    def _lateral_normal(self, ahead_m: float) -> float:
        reach = max(_SHORTEST_RETURN_M, _RETURN_S * self.state.speed_m_s)
        return self.left_m * float(np.exp(-ahead_m / reach))


def half_corridor_m(vehicle: Vehicle) -> float:
    """Return how far to either side of the path a vehicle needs the road for itself."""
    return vehicle.width_m / 2 + _CLEARANCE_M


_CLEARANCE_M = 0.25
"""Free space that a driver wants beside the car; streets with parked cars leave half a metre."""
