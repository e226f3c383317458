"""How other road users move: one rule each, made anew for every run."""

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

from ..geometry import PlanarBox
from ..route import Route
from ..vehicle import Vehicle, VehicleState, vehicle_box

# § Somebody else on the road, at a moment. World frame, metres.


@dataclass(frozen=True, slots=True)
class RoadUser:
    """A thing that may be driven into: its box on the ground, around its middle, and how fast it goes."""

    id: str
    class_name: str
    """As the scene calls it: "car", "truck", "pedestrian"."""
    size_lwh: tuple[float, float, float]
    """Metres."""
    x_m: float
    y_m: float
    yaw_rad: float
    """Counter-clockwise from the world's x."""
    speed_m_s: float = 0.0
    """Along its heading."""
    z_m: float = 0.0
    """Height of its bottom."""

    @property
    def box(self) -> PlanarBox:
        return PlanarBox(self.x_m, self.y_m, self.yaw_rad, self.size_lwh[0], self.size_lwh[1])

    @property
    def pose(self) -> Float64[np.ndarray, "4 4"]:
        """From its own frame (x forward, y left, z up, origin at the bottom centre) to the world."""
        matrix = np.eye(4)
        cosine, sine = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        matrix[:2, :2] = [[cosine, -sine], [sine, cosine]]
        matrix[:3, 3] = self.x_m, self.y_m, self.z_m
        return matrix

    def ahead(self, distance_m: float) -> "RoadUser":
        """Return it so far ahead along its heading."""
        x = self.x_m + distance_m * float(np.cos(self.yaw_rad))
        return replace(self, x_m=x, y_m=self.y_m + distance_m * float(np.sin(self.yaw_rad)))

    def moved(self, **fields: float) -> "RoadUser":
        """Return it elsewhere, or at another speed."""
        return replace(self, **fields)


@dataclass(frozen=True, slots=True, eq=False)
class TrafficState:
    """What a road user knows when it decides where to be next: all as it is now, before anybody has moved."""

    time_s: float
    """Since the scenario began."""
    ego: RoadUser
    others: tuple[RoadUser, ...]
    """Everybody else but itself, who is there now."""
    route: Route
    """The ego vehicle's way, which stands for the road."""


@runtime_checkable
class Behavior(Protocol):
    """Moves one road user. Deterministic: it knows the surroundings and what it did before, no clock and no chance."""

    def start(self, placed: RoadUser) -> RoadUser | None:
        """Return where it is at the beginning: where the scenario places it, if it has no place of its own."""
        ...

    def next(self, me: RoadUser | None, around: TrafficState, dt_s: float) -> RoadUser | None:
        """Return where it is a time later; None while it is not there, before it comes and after it has gone."""
        ...


# § The ego vehicle as the others see it: one road user more.

EGO = "ego"
"""Its id; no other road user is called so."""


def ego_user(vehicle: Vehicle, state: VehicleState) -> RoadUser:
    """Return the ego vehicle as a road user: its body's middle, not the rear axle. Its height is not told."""
    box = vehicle_box(vehicle, state)
    size = vehicle.length_m, vehicle.width_m, vehicle.height_m
    return RoadUser(EGO, "car", size, box.x_m, box.y_m, state.yaw_rad, state.speed_m_s)


# § A road user whose place depends on the time alone, whatever happens around it.


class TimeParametrizedBehavior:
    """A `Behavior`. A kind of it says in `_at` where the road user is at a time."""

    _me: RoadUser | None = None
    """As it was placed."""

    def start(self, placed: RoadUser) -> RoadUser | None:
        """Say where it begins; None where it is not there yet."""
        self._me = placed
        return self._at(placed, 0.0)

    def next(self, me: RoadUser | None, around: TrafficState, dt_s: float) -> RoadUser | None:
        """Say where it is after a step; None where it is not there."""
        return None if self._me is None else self._at(self._me, around.time_s + dt_s)

    def _at(self, me: RoadUser, time_s: float) -> RoadUser | None:
        """Return it (`me` is how it was placed) at a time since the scenario began."""
        raise NotImplementedError


# § Where a road user is on the road, by the route: how far along it, how far beside it, and which way it heads.


@dataclass(frozen=True, slots=True)
class LanePosition:
    """A place in a lane that runs beside a route."""

    along_m: float
    left_m: float
    """Of the route, seen in its direction."""
    direction: int
    """1 with the route, -1 against it."""

    @staticmethod
    def of(route: Route, user: RoadUser) -> "LanePosition":
        on = route.nearest(user.x_m, user.y_m)
        heading = route.at(on.along_m)[2]
        return LanePosition(on.along_m, on.left_m, 1 if np.cos(user.yaw_rad - heading) >= 0 else -1)

    def ahead(self, route: Route, distance_m: float) -> "LanePosition":
        """Return the place that is reached after a distance in the lane: in bends it is not that of the route."""
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
        """Put a road user here. `drift_m_s` is how fast it also moves to its own left, which turns its heading."""
        x, y, heading = route.at(self.along_m, self.left_m)
        yaw = heading if self.direction > 0 else heading + np.pi
        if speed_m_s > 0:
            yaw += np.arctan2(drift_m_s, speed_m_s)
        return me.moved(x_m=x, y_m=y, yaw_rad=float(yaw), speed_m_s=float(np.hypot(speed_m_s, drift_m_s)))


@dataclass(frozen=True, slots=True)
class VehicleAhead:
    """Somebody who is ahead in one's lane."""

    gap_m: float
    """From bumper to bumper along the lane; below 0 where they overlap."""
    speed_m_s: float
    """Away from oneself, along the lane."""


def find_vehicle_ahead(route: Route, me: RoadUser, users: tuple[RoadUser, ...]) -> VehicleAhead | None:
    """Find the nearest of road users whose middle is ahead and whose width overlaps one's own lane; None if nobody."""
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
    """Return the gap from bumper to bumper along a route, whichever is ahead; below 0 where they are side by side."""
    places = [LanePosition.of(route, each) for each in (one, other)]
    lengths = [_extent(route, place, user)[0] for place, user in zip(places, (one, other), strict=True)]
    return abs(places[1].along_m - places[0].along_m) - sum(lengths)


def _extent(route: Route, place: LanePosition, user: RoadUser) -> tuple[float, float]:
    """Half of what a road user takes up along a route, and across it."""
    turn = user.yaw_rad - route.at(place.along_m)[2]
    cosine, sine = abs(float(np.cos(turn))), abs(float(np.sin(turn)))
    length, width = user.size_lwh[0] / 2, user.size_lwh[1] / 2
    return length * cosine + width * sine, length * sine + width * cosine


# § How far one gets in a time while the speed changes at a rate, until it is what it should be.


def changed_speed(speed_m_s: float, to_m_s: float, rate_m_s2: float, dt_s: float) -> tuple[float, float]:
    """Return the speed after a time, and the distance driven, where it goes to another at a rate and then stays."""
    needed_s = abs(to_m_s - speed_m_s) / rate_m_s2 if rate_m_s2 > 0 else float("inf")
    changing_s = min(needed_s, dt_s)
    sign = 1.0 if to_m_s >= speed_m_s else -1.0
    after = to_m_s if needed_s <= dt_s else speed_m_s + sign * rate_m_s2 * dt_s
    return after, 0.5 * (speed_m_s + after) * changing_s + after * (dt_s - changing_s)
