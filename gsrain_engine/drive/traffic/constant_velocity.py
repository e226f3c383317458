"""A road user that goes straight on at its speed."""

from typing import TYPE_CHECKING

import msgspec

from .behaviour import Behaviour, Surroundings
from .road_user import RoadUser

if TYPE_CHECKING:
    from gsrain_engine.scene.scene import Scene


class ConstantVelocity(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="constant-velocity"
):
    """Straight on, at the speed that it begins with; 0 m/s stands still."""

    def begin(self, scene: "Scene", start_s: float) -> Behaviour:
        """Make the rule for one run, which begins at a time of the scene."""
        return _StraightOn()


class _StraightOn:
    def start(self, placed: RoadUser) -> RoadUser | None:
        return placed

    def next(self, me: RoadUser | None, around: Surroundings, dt_s: float) -> RoadUser | None:
        if me is None:
            return None
        return me.ahead(me.speed_m_s * dt_s)
