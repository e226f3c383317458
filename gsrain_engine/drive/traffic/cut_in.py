"""A road user that changes into the ego vehicle's lane."""

from typing import TYPE_CHECKING, Annotated

from msgspec import Meta

from .behaviour import Behaviour, Surroundings
from .in_lane import InLane
from .road_user import RoadUser
from .speed_change import changed_speed
from .trigger import Trigger, Triggered

if TYPE_CHECKING:
    from gsrain_engine.scene.scene import Scene


class CutIn(Triggered, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="cut-in"):
    """Keeps its lane and speed until it is set off, then moves across along a quintic polynomial.

    With u the share of the time that has passed, it has gone 10 u^3 - 15 u^4 + 6 u^5 of the way across: there is no
    lateral speed nor acceleration at either end (the minimum-jerk profile, Flash and Hogan 1985).
    """

    duration_s: Annotated[float, Meta(gt=0, le=60, title="Duration", extra={"unit": "s"})] = 3.0
    offset_m: (
        Annotated[
            float,
            Meta(ge=-50, le=50, title="Offset", description="How far it moves across, left of the route positive; "
                 "none: onto the route's line.", extra={"unit": "m"}),
        ]
        | None
    ) = None  # fmt: skip
    to_speed_m_s: (
        Annotated[
            float,
            Meta(ge=0, le=60, title="Speed after", description="Along the road; none keeps it.", extra={"unit": "m/s"}),
        ]
        | None
    ) = None
    speed_delay_s: Annotated[
        float,
        Meta(ge=0, le=60, title="Speed delay", description="From setting out until the speed begins to change.",
             extra={"unit": "s"}),
    ] = 0.0  # fmt: skip
    acceleration_m_s2: Annotated[
        float,
        Meta(gt=0, le=20, title="Acceleration", description="To that speed, or braking to it.", extra={"unit": "m/s2"}),
    ] = 2.0

    def begin(self, scene: "Scene", start_s: float) -> Behaviour:
        """Make the rule for one run, which begins at a time of the scene."""
        return _CuttingIn(self)


def quintic(share: float) -> float:
    """Return how much of the way is behind after a share (0..1) of the time: 10 u^3 - 15 u^4 + 6 u^5."""
    return share**3 * (10 + share * (6 * share - 15))


def quintic_rate(share: float) -> float:
    """Return its derivative, 30 u^2 (1 - u)^2."""
    return 30 * (share * (1 - share)) ** 2


class _CuttingIn:
    def __init__(self, settings: CutIn) -> None:
        self._settings, self._trigger = settings, Trigger(settings)
        self._place: InLane | None = None
        self._from_left_m = 0.0
        self._speed_m_s = 0.0
        """Along the road; the road user's own is that along its heading."""

    def start(self, placed: RoadUser) -> RoadUser | None:
        self._speed_m_s = placed.speed_m_s
        return placed

    def next(self, me: RoadUser | None, around: Surroundings, dt_s: float) -> RoadUser | None:
        if me is None:
            return None
        route, wanted = around.route, self._settings
        if self._place is None:
            self._place = InLane.of(route, me)
            self._from_left_m = self._place.left_m
        since = self._trigger.watch(me, around)
        keeps = since is None or wanted.to_speed_m_s is None or around.time_s < since + wanted.speed_delay_s - 1e-9
        to = self._speed_m_s if keeps or wanted.to_speed_m_s is None else wanted.to_speed_m_s
        self._speed_m_s, distance = changed_speed(self._speed_m_s, to, wanted.acceleration_m_s2, dt_s)
        place = self._place.ahead(route, distance)
        share = 0.0 if since is None else min((around.time_s + dt_s - since) / wanted.duration_s, 1.0)
        across = -self._from_left_m if wanted.offset_m is None else wanted.offset_m
        self._place = InLane(place.along_m, self._from_left_m + across * quintic(share), place.direction)
        drift = place.direction * across * quintic_rate(share) / wanted.duration_s
        return self._place.user(route, me, self._speed_m_s, drift)
