"""A road user that brakes: the test of a lead vehicle that slows down."""

from typing import TYPE_CHECKING, Annotated

from msgspec import Meta

from .behaviour import Behaviour, Surroundings
from .in_lane import InLane
from .road_user import RoadUser
from .speed_change import changed_speed
from .trigger import Trigger, Triggered

if TYPE_CHECKING:
    from gsrain_engine.scene.scene import Scene


class Brake(Triggered, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="brake"):
    """Keeps its lane and speed until it is set off, then brakes at a rate; it stays as slow as it gets.

    Euro NCAP's braking lead vehicle brakes at 2 or 6 m/s2 to a standstill (AEB car-to-car protocol, CCRb).
    """

    deceleration_m_s2: Annotated[float, Meta(gt=0, le=20, title="Deceleration", extra={"unit": "m/s2"})] = 6.0
    to_speed_m_s: Annotated[float, Meta(ge=0, le=60, title="Speed after", extra={"unit": "m/s"})] = 0.0

    def begin(self, scene: "Scene", start_s: float) -> Behaviour:
        """Make the rule for one run, which begins at a time of the scene."""
        return _Braking(self)


class _Braking:
    def __init__(self, settings: Brake) -> None:
        self._settings, self._trigger = settings, Trigger(settings)
        self._place: InLane | None = None

    def start(self, placed: RoadUser) -> RoadUser | None:
        return placed

    def next(self, me: RoadUser | None, around: Surroundings, dt_s: float) -> RoadUser | None:
        if me is None:
            return None
        place = self._place or InLane.of(around.route, me)
        is_off = self._trigger.watch(me, around) is None
        to = me.speed_m_s if is_off else min(me.speed_m_s, self._settings.to_speed_m_s)
        speed, distance = changed_speed(me.speed_m_s, to, self._settings.deceleration_m_s2, dt_s)
        self._place = place.ahead(around.route, distance)
        return self._place.user(around.route, me, speed)
