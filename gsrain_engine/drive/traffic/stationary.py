"""A road user that stands still."""

from typing import TYPE_CHECKING

import msgspec

from .behaviour import Behaviour, Surroundings
from .road_user import RoadUser

if TYPE_CHECKING:
    from gsrain_engine.scene.scene import Scene


class Stationary(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="stationary"
):
    """Stands where it is placed, whatever speed it is given."""

    def begin(self, scene: "Scene", start_s: float) -> Behaviour:
        """Make the rule for one run, which begins at a time of the scene."""
        return _Standing()


class _Standing:
    def start(self, placed: RoadUser) -> RoadUser | None:
        return placed.moved(speed_m_s=0.0)

    def next(self, me: RoadUser | None, around: Surroundings, dt_s: float) -> RoadUser | None:
        return me
