"""Road users, the behavior protocol, lane positions and gaps. World frame, meters."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from ..geometry import PlanarBox, Route
from ..vehicle import Vehicle, VehicleState, vehicle_box
from ..vehicle_settings import EGO


@dataclass(frozen=True, slots=True)
class RoadUser:
    """A road user: bounding box on the ground around its center, with a speed."""

    id: str
    class_name: str
    """Class name as in the scene: "car", "truck", "pedestrian"."""
    size_lwh: tuple[float, float, float]
    """Length, width and height in meters."""
    x_m: float
    y_m: float
    yaw_rad: float
    """Counterclockwise from the world's x axis."""
    speed_m_s: float = 0.0
    """Speed along the heading."""
    z_m: float = 0.0
    """Height of the bottom face."""

    @property
    def box(self) -> PlanarBox:
        return PlanarBox(self.x_m, self.y_m, self.yaw_rad, self.size_lwh[0], self.size_lwh[1])

    @property
    def pose(self) -> Float64[np.ndarray, "4 4"]:
        """Pose from its own frame (x forward, y left, z up, origin at the bottom center) to the world."""
        return VehicleState(self.x_m, self.y_m, self.yaw_rad).rig_to_world(self.z_m)

    def ahead(self, distance_m: float) -> "RoadUser":
        """Return the road user moved ahead along its heading."""
        x = self.x_m + distance_m * float(np.cos(self.yaw_rad))
        return replace(self, x_m=x, y_m=self.y_m + distance_m * float(np.sin(self.yaw_rad)))


@dataclass(frozen=True, slots=True, eq=False)
class TrafficState:
    """Input of a behavior: the states of all road users before the step, and the time since the scenario began."""

    time_s: float
    ego: RoadUser
    others: tuple[RoadUser, ...]  # all other road users present
    route: Route  # the ego vehicle's route, which represents the road
    grip_m_s2: Callable[[float], float] | None = None  # acceleration that tires transmit, by speed; None has no limit

    def braking_m_s2(self, speed_m_s: float, asked_m_s2: float) -> float:
        """Return the deceleration that the road allows at a speed, at most what is asked for."""
        return asked_m_s2 if self.grip_m_s2 is None else min(asked_m_s2, self.grip_m_s2(speed_m_s))


class Behavior:
    """Moves one road user. Deterministic: depends only on the surroundings and its own past."""

    def start(self, placed: RoadUser) -> RoadUser | None:
        """Return the initial state, by default `placed`, the one from the scenario; None if absent."""
        return placed

    def next(self, me: RoadUser, around: TrafficState, dt_s: float) -> RoadUser | None:
        """Return the state after a step, None while absent. `me` is the latest state, initially the placed one."""
        raise NotImplementedError


def ego_user(vehicle: Vehicle, state: VehicleState) -> RoadUser:
    """Return the ego vehicle as a road user, at the center of its body. Its height is not set."""
    box, size = vehicle_box(vehicle, state), (vehicle.length_m, vehicle.width_m, vehicle.height_m)
    return RoadUser(EGO, "car", size, box.x_m, box.y_m, state.yaw_rad, state.speed_m_s)


@dataclass(frozen=True, slots=True)
class LanePosition:
    """A position in a lane parallel to a route: arc length, lateral offset, direction of travel."""

    along_m: float
    left_m: float  # lateral offset from the route, left positive in its direction
    direction: int  # 1 with the route, -1 against it

    @staticmethod
    def of(route: Route, user: RoadUser) -> "LanePosition":
        on = route.nearest(user.x_m, user.y_m)
        heading = route.at(on.along_m)[2]
        return LanePosition(on.along_m, on.left_m, 1 if np.cos(user.yaw_rad - heading) >= 0 else -1)

    def ahead(self, route: Route, distance_m: float) -> "LanePosition":
        """Return the position after a distance in the lane; in bends it differs from the distance along the route."""
        step = self.direction * distance_m
        x, y, _ = route.at(self.along_m, self.left_m)
        for _ in range(2):
            to_x, to_y, _ = route.at(self.along_m + step, self.left_m)
            reached = float(np.hypot(to_x - x, to_y - y))
            if reached < 1e-9:
                break
            step *= distance_m / reached
        return replace(self, along_m=self.along_m + step)

    def user(self, route: Route, me: RoadUser, speed_m_s: float, drift_m_s: float = 0.0) -> RoadUser:
        """Return a road user at this position; `drift_m_s`, its lateral speed to its left, turns its heading."""
        x, y, heading = route.at(self.along_m, self.left_m)
        yaw = heading if self.direction > 0 else heading + np.pi
        if speed_m_s > 0:
            yaw += np.arctan2(drift_m_s, speed_m_s)
        return replace(me, x_m=x, y_m=y, yaw_rad=float(yaw), speed_m_s=float(np.hypot(speed_m_s, drift_m_s)))


@dataclass(frozen=True, slots=True)
class VehicleAhead:
    """A road user ahead in the lane."""

    gap_m: float  # bumper-to-bumper gap along the lane; negative if they overlap
    speed_m_s: float  # speed away from the follower, along the lane


def find_vehicle_ahead(route: Route, me: RoadUser, users: tuple[RoadUser, ...]) -> VehicleAhead | None:
    """Find the nearest road user whose center is ahead and whose width overlaps the own lane; None if there is none."""
    mine = LanePosition.of(route, me)
    own_length, own_width = _extent(route, mine, me)
    found: list[VehicleAhead] = []
    for user in users:
        theirs = LanePosition.of(route, user)
        length, width = _extent(route, theirs, user)
        away = mine.direction * (theirs.along_m - mine.along_m)
        if away > 0 and abs(theirs.left_m - mine.left_m) < own_width + width:
            along = mine.direction * float(np.cos(user.yaw_rad - route.at(theirs.along_m)[2]))
            found.append(VehicleAhead(away - own_length - length, user.speed_m_s * along))
    return min(found, key=lambda each: each.gap_m, default=None)


def gap_between(route: Route, one: RoadUser, other: RoadUser) -> float:
    """Return the bumper-to-bumper gap along a route, in either order; negative if they are side by side."""
    places = [LanePosition.of(route, each) for each in (one, other)]
    lengths = [_extent(route, place, user)[0] for place, user in zip(places, (one, other), strict=True)]
    return abs(places[1].along_m - places[0].along_m) - sum(lengths)


def _extent(route: Route, place: LanePosition, user: RoadUser) -> tuple[float, float]:
    """Return half the extent of a road user along and across a route."""
    turn = user.yaw_rad - route.at(place.along_m)[2]
    cosine, sine = abs(float(np.cos(turn))), abs(float(np.sin(turn)))
    length, width = user.size_lwh[0] / 2, user.size_lwh[1] / 2
    return length * cosine + width * sine, length * sine + width * cosine


def changed_speed(speed_m_s: float, to_m_s: float, rate_m_s2: float, dt_s: float) -> tuple[float, float]:
    """Return the speed after a time, and the distance, under a constant rate until the target speed is reached."""
    needed_s = abs(to_m_s - speed_m_s) / rate_m_s2 if rate_m_s2 > 0 else float("inf")
    changing_s = min(needed_s, dt_s)
    sign = 1.0 if to_m_s >= speed_m_s else -1.0
    after = to_m_s if needed_s <= dt_s else speed_m_s + sign * rate_m_s2 * dt_s
    return after, 0.5 * (speed_m_s + after) * changing_s + after * (dt_s - changing_s)
