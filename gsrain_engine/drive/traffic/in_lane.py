"""Where a road user is on the road, by the route: how far along it, how far beside it, and which way it heads."""

from dataclasses import dataclass, replace

import numpy as np

from ..road.route import Route
from .road_user import RoadUser


@dataclass(frozen=True, slots=True)
class InLane:
    """A place in a lane that runs beside a route."""

    along_m: float
    left_m: float
    """Of the route, seen in its direction."""
    direction: int
    """1 with the route, -1 against it."""

    @staticmethod
    def of(route: Route, user: RoadUser) -> "InLane":
        on = route.nearest(user.x_m, user.y_m)
        heading = route.at(on.along_m)[2]
        return InLane(on.along_m, on.left_m, 1 if np.cos(user.yaw_rad - heading) >= 0 else -1)

    def ahead(self, route: Route, distance_m: float) -> "InLane":
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
class Ahead:
    """Somebody who is ahead in one's lane."""

    gap_m: float
    """From bumper to bumper along the lane; below 0 where they overlap."""
    speed_m_s: float
    """Away from oneself, along the lane."""


def ahead_in_lane(route: Route, me: RoadUser, users: tuple[RoadUser, ...]) -> Ahead | None:
    """Find the nearest of road users whose middle is ahead and whose width overlaps one's own lane; None if nobody."""
    mine = InLane.of(route, me)
    own_length, own_width = _extent(route, mine, me)
    found: list[Ahead] = []
    for user in users:
        theirs = InLane.of(route, user)
        length, width = _extent(route, theirs, user)
        away = mine.direction * (theirs.along_m - mine.along_m)
        if away > 0 and abs(theirs.left_m - mine.left_m) < own_width + width:
            along = mine.direction * float(np.cos(user.yaw_rad - route.at(theirs.along_m)[2]))
            found.append(Ahead(away - own_length - length, user.speed_m_s * along))
    return min(found, key=lambda each: each.gap_m, default=None)


def gap_between(route: Route, one: RoadUser, other: RoadUser) -> float:
    """Return the gap from bumper to bumper along a route, whichever is ahead; below 0 where they are side by side."""
    places = [InLane.of(route, each) for each in (one, other)]
    lengths = [_extent(route, place, user)[0] for place, user in zip(places, (one, other), strict=True)]
    return abs(places[1].along_m - places[0].along_m) - sum(lengths)


def _extent(route: Route, place: InLane, user: RoadUser) -> tuple[float, float]:
    """Half of what a road user takes up along a route, and across it."""
    turn = user.yaw_rad - route.at(place.along_m)[2]
    cosine, sine = abs(float(np.cos(turn))), abs(float(np.sin(turn)))
    length, width = user.size_lwh[0] / 2, user.size_lwh[1] / 2
    return length * cosine + width * sine, length * sine + width * cosine
