"""The Intelligent Driver Model: follows its lane, and whoever is ahead in it."""

from typing import TYPE_CHECKING, Annotated

import msgspec
import numpy as np
from msgspec import Meta

from .behaviour import Behaviour, Surroundings
from .in_lane import InLane, ahead_in_lane
from .road_user import RoadUser
from .speed_change import changed_speed

if TYPE_CHECKING:
    from gsrain_engine.scene.scene import Scene


class IntelligentDriver(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="idm"
):
    """Drives along the route in its own lane as Treiber, Hennecke and Helbing (2000) have it.

    The defaults are Treiber and Kesting's for city traffic (2013, table 11.2). HUGSIM's are 30 m/s, 5 m, 2 s, 2 m/s2
    and 4 m/s2.
    """

    desired_speed_m_s: Annotated[float, Meta(gt=0, le=60, title="Desired speed", extra={"unit": "m/s"})] = 15.0
    least_gap_m: Annotated[
        float, Meta(ge=0, le=50, title="Least gap", description="At a standstill.", extra={"unit": "m"})
    ] = 2.0
    headway_s: Annotated[float, Meta(ge=0, le=10, title="Headway", extra={"unit": "s"})] = 1.0
    acceleration_m_s2: Annotated[float, Meta(gt=0, le=10, title="Acceleration", extra={"unit": "m/s2"})] = 1.0
    comfortable_braking_m_s2: Annotated[
        float, Meta(gt=0, le=10, title="Comfortable braking", extra={"unit": "m/s2"})
    ] = 1.5
    exponent: Annotated[float, Meta(ge=1, le=20, title="Exponent")] = 4.0
    most_braking_m_s2: Annotated[float, Meta(gt=0, le=20, title="Most braking", extra={"unit": "m/s2"})] = 8.0

    def begin(self, scene: "Scene", start_s: float) -> Behaviour:
        """Make the rule for one run, which begins at a time of the scene."""
        return _Following(self)

    def acceleration(self, speed_m_s: float, gap_m: float | None, closing_m_s: float = 0.0) -> float:
        """Return what the model asks for (its eq. 2 and 3), no harder than the hardest braking; no gap is a free road.

        `closing_m_s` is one's own speed less that of who is ahead.
        """
        free = 1 - (speed_m_s / self.desired_speed_m_s) ** self.exponent
        if gap_m is None:
            return max(self.acceleration_m_s2 * free, -self.most_braking_m_s2)
        comfort = 2 * np.sqrt(self.acceleration_m_s2 * self.comfortable_braking_m_s2)
        wanted = self.least_gap_m + max(0.0, speed_m_s * self.headway_s + speed_m_s * closing_m_s / float(comfort))
        asked = self.acceleration_m_s2 * (free - (wanted / max(gap_m, 0.01)) ** 2)
        return max(asked, -self.most_braking_m_s2)


class _Following:
    def __init__(self, settings: IntelligentDriver) -> None:
        self._settings = settings
        self._place: InLane | None = None

    def start(self, placed: RoadUser) -> RoadUser | None:
        return placed

    def next(self, me: RoadUser | None, around: Surroundings, dt_s: float) -> RoadUser | None:
        if me is None:
            return None
        route = around.route
        place = self._place or InLane.of(route, me)
        ahead = ahead_in_lane(route, me, (around.ego, *around.others))
        closing = 0.0 if ahead is None else me.speed_m_s - ahead.speed_m_s
        asked = self._settings.acceleration(me.speed_m_s, None if ahead is None else ahead.gap_m, closing)
        to = max(0.0, me.speed_m_s + asked * dt_s) if asked < 0 else me.speed_m_s + asked * dt_s
        speed, distance = changed_speed(me.speed_m_s, to, abs(asked), dt_s)
        self._place = place.ahead(route, distance)
        return self._place.user(route, me, speed)
