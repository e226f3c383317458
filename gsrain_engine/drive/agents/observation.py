"""What a driving agent is shown at a moment."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float32, Float64, UInt8, UInt16

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import RigCamera

from ..road.route import Route
from ..traffic.road_user import RoadUser
from ..vehicle.state import VehicleState
from ..vehicle.vehicle import Vehicle

Command = Literal["right", "left", "straight"]
COMMANDS: tuple[Command, ...] = ("right", "left", "straight")
"""In the order of nuScenes' numbers, which UniAD, HUGSIM and NeuroNCAP share: 0, 1, 2."""


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """What does not change during a drive: the vehicle, and the cameras that an agent gets pictures of."""

    vehicle: Vehicle
    cameras: tuple[RigCamera, ...]
    """In the rig frame (x forward, y left, z up, origin above the rear axle), of the size of the pictures."""
    height_m: float
    """Of the rig frame's origin above the road."""


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
