"""Behaviors of road users by `kind`: IDM, brake, constant velocity, stationary, cut-in."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from ...scene.scene import Scene
from .base import Behavior, LanePosition, RoadUser, TrafficState, changed_speed, find_vehicle_ahead, gap_between
from .settings import (
    BehaviorSettings,
    Brake,
    ConstantVelocity,
    CutIn,
    IntelligentDriver,
    ScriptedTrack,
    Stationary,
    Triggered,
)
from .tracks import TimedBehavior, on_track, replaying


def begin_behavior(settings: BehaviorSettings, scene: Scene, start_s: float) -> Behavior:
    """Create the behavior of one run that begins at a scene time; raises ValueError for tracks that are not there."""
    match settings:
        case IntelligentDriver():
            return _LaneKeeper(partial(_idm_speed, settings))
        case Brake():
            return _LaneKeeper(partial(_braking_speed, settings, Trigger(settings)))
        case ConstantVelocity():
            return _ConstantVelocityBehavior()
        case Stationary():
            return TimedBehavior(_standing)
        case CutIn():
            return _CutInBehavior(settings)
        case ScriptedTrack():
            return on_track(settings, scene, start_s)
        case _:
            return replaying(settings)


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
