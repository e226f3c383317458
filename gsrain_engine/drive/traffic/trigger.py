"""What sets a road user's manoeuvre off."""

from typing import Annotated

import msgspec
from msgspec import Meta

from .behaviour import Surroundings
from .in_lane import InLane, gap_between
from .road_user import RoadUser


class Triggered(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Exactly one of three things sets it off; the others are left out."""

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
        given = [each for each in (self.after_s, self.gap_m, self.time_to_collision_s) if each is not None]
        if len(given) != 1:
            raise ValueError("exactly one of `after_s`, `gap_m` and `time_to_collision_s` sets it off")


class Trigger:
    """Watches for the moment that a manoeuvre begins."""

    def __init__(self, settings: Triggered) -> None:
        self._settings = settings
        self._began_nearer: bool | None = None
        self.since_s: float | None = None
        """When it went off."""

    def watch(self, me: RoadUser, around: Surroundings) -> float | None:
        """Look at a moment; returns when it went off, None while it has not."""
        if self.since_s is None and self._goes_off(me, around):
            self.since_s = around.time_s
        return self.since_s

    def _goes_off(self, me: RoadUser, around: Surroundings) -> bool:
        wanted = self._settings
        if wanted.after_s is not None:
            return around.time_s >= wanted.after_s - 1e-9
        gap = gap_between(around.route, me, around.ego)
        if wanted.gap_m is not None:
            if self._began_nearer is None:
                self._began_nearer = gap < wanted.gap_m
            return gap >= wanted.gap_m if self._began_nearer else gap <= wanted.gap_m
        assert wanted.time_to_collision_s is not None
        mine, egos = InLane.of(around.route, me), InLane.of(around.route, around.ego)
        closing = around.ego.speed_m_s - mine.direction * egos.direction * me.speed_m_s
        is_behind = egos.direction * (mine.along_m - egos.along_m) > 0
        return is_behind and closing > 0 and max(gap, 0.0) <= wanted.time_to_collision_s * closing
