"""Behaviors of road users by `kind`: IDM, brake, constant velocity, stationary, cut-in."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Annotated

import numpy as np
from msgspec import Meta

from ...scene.scene import Scene
from ...settings import Settings
from .base import Behavior, LanePosition, RoadUser, TrafficState, changed_speed, find_vehicle_ahead, gap_between
from .tracks import Replay, ScriptedTrack, TimedBehavior


class IntelligentDriver(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="idm"):
    """Drives along the route in its own lane by the IDM (Treiber, Hennecke and Helbing 2000).

    The defaults are Treiber and Kesting's for city traffic (2013, table 11.2). HUGSIM's are 30 m/s, 5 m, 2 s, 2 m/s2
    and 4 m/s2.
    """

    desired_speed_m_s: Annotated[float, Meta(gt=0, le=60, title="Desired speed", extra={"unit": "m/s"})] = 15.0
    least_gap_m: Annotated[
        float, Meta(ge=0, le=50, title="Min. gap", description="At a standstill.", extra={"unit": "m"})
    ] = 2.0
    headway_s: Annotated[float, Meta(ge=0, le=10, title="Headway", extra={"unit": "s"})] = 1.0
    acceleration_m_s2: Annotated[float, Meta(gt=0, le=10, title="Acceleration", extra={"unit": "m/s\u00b2"})] = 1.0
    comfortable_braking_m_s2: Annotated[
        float, Meta(gt=0, le=10, title="Comfortable braking", extra={"unit": "m/s\u00b2"})
    ] = 1.5
    exponent: Annotated[float, Meta(ge=1, le=20, title="Exponent")] = 4.0
    most_braking_m_s2: Annotated[float, Meta(gt=0, le=20, title="Max. braking", extra={"unit": "m/s\u00b2"})] = 8.0

    def begin(self, scene: Scene, start_s: float) -> Behavior:
        return _LaneKeeper(partial(_idm_speed, self))

    def acceleration(self, speed_m_s: float, gap_m: float | None, closing_m_s: float = 0.0) -> float:
        """Return the IDM acceleration (eq. 2 and 3), limited by maximum braking; a gap of None is a free road.

        `closing_m_s` is the own speed minus that of the leader.
        """
        free = 1 - (speed_m_s / self.desired_speed_m_s) ** self.exponent
        if gap_m is None:
            return max(self.acceleration_m_s2 * free, -self.most_braking_m_s2)
        comfort = 2 * np.sqrt(self.acceleration_m_s2 * self.comfortable_braking_m_s2)
        desired = self.least_gap_m + max(0.0, speed_m_s * self.headway_s + speed_m_s * closing_m_s / float(comfort))
        rate = self.acceleration_m_s2 * (free - (desired / max(gap_m, 0.01)) ** 2)
        return max(rate, -self.most_braking_m_s2)


class Triggered(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Trigger of a maneuver: exactly one of three conditions is set."""

    after_s: (
        Annotated[float, Meta(ge=0, title="After", description="Since the scenario began.", extra={"unit": "s"})] | None
    ) = None
    gap_m: (
        Annotated[
            float,
            Meta(ge=0, title="Gap", description="When the gap to the ego vehicle, from bumper to bumper along the "
                 "road, has shrunk or grown to this.", extra={"unit": "m"}),
        ]
        | None
    ) = None  # fmt: skip
    time_to_collision_s: (
        Annotated[
            float,
            Meta(ge=0, title="Time to collision", description="When the ego vehicle, behind it, would be at its "
                 "bumper after this time, would both keep their speeds.", extra={"unit": "s"}),
        ]
        | None
    ) = None  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if sum(each is not None for each in (self.after_s, self.gap_m, self.time_to_collision_s)) != 1:
            raise ValueError("exactly one of `after_s`, `gap_m` and `time_to_collision_s` sets it off")


class Brake(Triggered, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="brake"):
    """Keeps its lane and speed until triggered, then brakes at a constant rate and keeps the final speed.

    Euro NCAP's braking lead vehicle brakes at 2 or 6 m/s2 to a standstill (AEB car-to-car protocol, CCRb).
    """

    deceleration_m_s2: Annotated[float, Meta(gt=0, le=20, title="Deceleration", extra={"unit": "m/s\u00b2"})] = 6.0
    to_speed_m_s: Annotated[float, Meta(ge=0, le=60, title="Speed after", extra={"unit": "m/s"})] = 0.0

    def begin(self, scene: Scene, start_s: float) -> Behavior:
        return _LaneKeeper(partial(_braking_speed, self, Trigger(self)))


class ConstantVelocity(
    Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="constant-velocity"
):
    """Drives straight on at its initial speed; 0 m/s stands still."""

    def begin(self, scene: Scene, start_s: float) -> Behavior:
        return _ConstantVelocityBehavior()


class Stationary(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="stationary"):
    """Stands at its initial place, ignoring its speed."""

    def begin(self, scene: Scene, start_s: float) -> Behavior:
        return TimedBehavior(_standing)


class CutIn(Triggered, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="cut-in"):
    """Keeps its lane and speed until triggered, then changes lanes along a quintic polynomial.

    At the fraction u of the duration, the lateral share is 10 u^3 - 15 u^4 + 6 u^5, without lateral speed or
    acceleration at either end (the minimum-jerk profile, Flash and Hogan 1985).
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
        Meta(
            gt=0,
            le=20,
            title="Acceleration",
            description="To that speed, or braking to it.",
            extra={"unit": "m/s\u00b2"},
        ),
    ] = 2.0

    def begin(self, scene: Scene, start_s: float) -> Behavior:
        return _CutInBehavior(self)


BehaviorSettings = ConstantVelocity | Stationary | IntelligentDriver | CutIn | Brake | ScriptedTrack | Replay
"""Settings of a behavior; `begin(scene, start_s)` creates the `Behavior` of one run."""


class _LaneKeeper(Behavior):
    """Keeps its lane."""

    def __init__(self, speed: Callable[[RoadUser, TrafficState, float], tuple[float, float]]) -> None:
        """Use `speed(me, around, dt_s)`, which returns the speed after a step and the distance covered."""
        self._speed = speed
        self._place: LanePosition | None = None

    def next(self, me: RoadUser, around: TrafficState, dt_s: float) -> RoadUser:
        speed, distance = self._speed(me, around, dt_s)
        self._place = (self._place or LanePosition.of(around.route, me)).ahead(around.route, distance)
        return self._place.user(around.route, me, speed)


def _idm_speed(idm: IntelligentDriver, me: RoadUser, around: TrafficState, dt_s: float) -> tuple[float, float]:
    ahead = find_vehicle_ahead(around.route, me, (around.ego, *around.others))
    closing = 0.0 if ahead is None else me.speed_m_s - ahead.speed_m_s
    rate = idm.acceleration(me.speed_m_s, None if ahead is None else ahead.gap_m, closing)
    rate = max(rate, -around.braking_m_s2(me.speed_m_s, idm.most_braking_m_s2))
    to = me.speed_m_s + rate * dt_s
    return changed_speed(me.speed_m_s, max(0.0, to) if rate < 0 else to, abs(rate), dt_s)


def _braking_speed(
    brake: Brake, trigger: "Trigger", me: RoadUser, around: TrafficState, dt_s: float
) -> tuple[float, float]:
    is_off = trigger.watch(me, around) is None
    to = me.speed_m_s if is_off else min(me.speed_m_s, brake.to_speed_m_s)
    return changed_speed(me.speed_m_s, to, around.braking_m_s2(me.speed_m_s, brake.deceleration_m_s2), dt_s)


class _ConstantVelocityBehavior(Behavior):
    def next(self, me: RoadUser, around: TrafficState, dt_s: float) -> RoadUser:
        return me.ahead(me.speed_m_s * dt_s)


def _standing(me: RoadUser, time_s: float) -> RoadUser:
    return replace(me, speed_m_s=0.0)


def quintic(share: float) -> float:
    """Return the covered share at a fraction of the time, 0..1: 10 u^3 - 15 u^4 + 6 u^5."""
    return share**3 * (10 + share * (6 * share - 15))


def quintic_rate(share: float) -> float:
    """Return the derivative of `quintic`, 30 u^2 (1 - u)^2."""
    return 30 * (share * (1 - share)) ** 2


class _CutInBehavior(Behavior):
    def __init__(self, settings: CutIn) -> None:
        self._settings, self._trigger = settings, Trigger(settings)
        self._place: LanePosition | None = None
        self._from_left_m = self._speed_m_s = 0.0
        """Initial offset from the route; speed along the road; that of the road user is along its heading."""

    def start(self, placed: RoadUser) -> RoadUser:
        self._speed_m_s = placed.speed_m_s
        return placed

    def next(self, me: RoadUser, around: TrafficState, dt_s: float) -> RoadUser:
        route, settings = around.route, self._settings
        if self._place is None:
            self._place = LanePosition.of(route, me)
            self._from_left_m = self._place.left_m
        since = self._trigger.watch(me, around)
        keeps = since is None or settings.to_speed_m_s is None or around.time_s < since + settings.speed_delay_s - 1e-9
        to = self._speed_m_s if keeps or settings.to_speed_m_s is None else settings.to_speed_m_s
        rate = around.braking_m_s2(self._speed_m_s, settings.acceleration_m_s2)
        self._speed_m_s, distance = changed_speed(self._speed_m_s, to, rate, dt_s)
        place = self._place.ahead(route, distance)
        share = 0.0 if since is None else min((around.time_s + dt_s - since) / settings.duration_s, 1.0)
        across = -self._from_left_m if settings.offset_m is None else settings.offset_m
        self._place = LanePosition(place.along_m, self._from_left_m + across * quintic(share), place.direction)
        drift = place.direction * across * quintic_rate(share) / settings.duration_s
        return self._place.user(route, me, self._speed_m_s, drift)


class Trigger:
    """Detects the start of a maneuver."""

    def __init__(self, settings: Triggered) -> None:
        self._settings = settings
        self._began_nearer: bool | None = None
        self._since_s: float | None = None

    def watch(self, me: RoadUser, around: TrafficState) -> float | None:
        """Check the trigger; returns its time, or None before it."""
        if self._since_s is None and self._goes_off(me, around):
            self._since_s = around.time_s
        return self._since_s

    def _goes_off(self, me: RoadUser, around: TrafficState) -> bool:
        settings = self._settings
        if settings.after_s is not None:
            return around.time_s >= settings.after_s - 1e-9
        gap = gap_between(around.route, me, around.ego)
        if settings.gap_m is not None:
            if self._began_nearer is None:
                self._began_nearer = gap < settings.gap_m
            return gap >= settings.gap_m if self._began_nearer else gap <= settings.gap_m
        assert settings.time_to_collision_s is not None
        mine, egos = LanePosition.of(around.route, me), LanePosition.of(around.route, around.ego)
        closing = around.ego.speed_m_s - mine.direction * egos.direction * me.speed_m_s
        is_behind = egos.direction * (mine.along_m - egos.along_m) > 0
        return is_behind and closing > 0 and max(gap, 0.0) <= settings.time_to_collision_s * closing
