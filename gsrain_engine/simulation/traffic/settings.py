"""Settings of the behaviors of road users, by `kind`."""

import math
from itertools import pairwise
from typing import Annotated

from msgspec import Meta

from ...settings import Settings


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

    def acceleration(self, speed_m_s: float, gap_m: float | None, closing_m_s: float = 0.0) -> float:
        """Return the IDM acceleration (eq. 2 and 3), limited by maximum braking; a gap of None is a free road.

        `closing_m_s` is the own speed minus that of the leader.
        """
        free = 1 - (speed_m_s / self.desired_speed_m_s) ** self.exponent
        if gap_m is None:
            return max(self.acceleration_m_s2 * free, -self.most_braking_m_s2)
        comfort = 2 * math.sqrt(self.acceleration_m_s2 * self.comfortable_braking_m_s2)
        desired = self.least_gap_m + max(0.0, speed_m_s * self.headway_s + speed_m_s * closing_m_s / comfort)
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


class ConstantVelocity(
    Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="constant-velocity"
):
    """Drives straight on at its initial speed; 0 m/s stands still."""


class Stationary(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="stationary"):
    """Stands at its initial place, ignoring its speed."""


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


class TrackPoint(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A time and a position relative to the initial place."""

    time_s: Annotated[
        float, Meta(gt=0, le=1e6, title="Time", description="Since the scenario began.", extra={"unit": "s"})
    ]
    ahead_m: Annotated[float, Meta(ge=-1e5, le=1e5, title="Ahead", description="Along the route.", extra={"unit": "m"})]
    left_m: Annotated[
        float, Meta(ge=-1e5, le=1e5, title="Left", description="Across it, seen in its direction.", extra={"unit": "m"})
    ] = 0.0


class ScriptedTrack(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="track"):
    """Follows the recorded track of an actor, or points with smooth interpolation, then stands.

    Between points positions are monotone cubics of time (PCHIP: Fritsch and Butland 1984), so nothing overshoots.
    """

    actor: Annotated[str | None, Meta(title="Actor", description="Id of the scene's actor whose track it is.")] = None
    pace: Annotated[
        float, Meta(gt=0, le=10, title="Pace", description="Of an actor: 0.5 takes twice the recorded time.")
    ] = 1.0
    points: tuple[TrackPoint, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.actor is None) != bool(self.points):
            raise ValueError("a track is either that of an `actor` or through `points`")
        times = [0.0, *(point.time_s for point in self.points)]
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise ValueError("`points` must be in the order of their times, which are later than 0 s")


class Replay(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="replay"):
    """Replays a road user, or the ego vehicle, of a finished drive; linear between steps."""

    rollout: Annotated[str, Meta(min_length=1, title="Roll-out", description="A roll-out file (JSON lines).")]
    user: Annotated[
        str, Meta(min_length=1, title="Road user", description='Its id in the roll-out; "ego" is its ego vehicle.')
    ]


BehaviorSettings = ConstantVelocity | Stationary | IntelligentDriver | CutIn | Brake | ScriptedTrack | Replay
"""Settings of a behavior; `models.begin_behavior` creates the behavior of one run."""
