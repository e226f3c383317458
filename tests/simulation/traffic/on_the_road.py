"""Moves road users by their behaviour on a route, without a scene."""

import msgspec
import numpy as np

from gsrain_engine.scene.scene import Scene
from gsrain_engine.simulation.geometry import Route
from gsrain_engine.simulation.traffic.base import Behavior, RoadUser, TrafficState
from gsrain_engine.simulation.traffic.models import BehaviorSettings

STRAIGHT = Route(np.array([[0.0, 0.0], [200.0, 0.0]]))
SIZE = (4.0, 2.0, 1.5)
NOWHERE = RoadUser("ego", "car", SIZE, -1000.0, 0.0, 0.0, 0.0)


def car(x, y=0.0, speed=0.0, yaw=0.0, id="car"):
    """A road user 4 m long and 2 m wide."""
    return RoadUser(id, "car", SIZE, float(x), float(y), float(yaw), float(speed))


def settings(**fields):
    """A behaviour as a scenario file states it."""
    return msgspec.convert(fields, BehaviorSettings)


def moves(behaviour, me, duration_s, *, ego=NOWHERE, others=(), route=STRAIGHT, dt_s=0.25, scene=None):
    """Move one road user; returns it at each moment, the start first. The ego vehicle and others keep their speeds."""
    rule = behaviour.begin(scene or Scene("none"), 0.0)
    assert isinstance(rule, Behavior)
    now = rule.start(me)
    seen = [now]
    for step in range(round(duration_s / dt_s)):
        around = TrafficState(step * dt_s, ego, tuple(others), route)
        me = now or me
        now = rule.next(me, around, dt_s)
        ego, others = ego.ahead(ego.speed_m_s * dt_s), tuple(each.ahead(each.speed_m_s * dt_s) for each in others)
        seen.append(now)
    return seen
