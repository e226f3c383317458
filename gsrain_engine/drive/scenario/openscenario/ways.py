"""Where road users go that follow tracks: sampled step by step, for trajectories."""

from dataclasses import dataclass, field

from ...traffic.road_user import RoadUser
from ..scenario import Scenario
from ..traffic import Traffic
from .manoeuvres import Place


@dataclass(frozen=True, slots=True)
class Way:
    """Places of a road user and their times, seconds since the scenario began; the first is where it comes."""

    times_s: list[float] = field(default_factory=list[float])
    places: list[Place] = field(default_factory=list[Place])


def ways(scenario: Scenario, traffic: Traffic, ego: RoadUser) -> dict[str, Way]:
    """Move everybody through the scenario around an ego vehicle that stands, and note where they are."""
    found: dict[str, Way] = {}
    for step in range(round(scenario.duration_s / scenario.step_s) + 1):
        time_s = step * scenario.step_s
        for user in traffic.users:
            way = found.setdefault(user.id, Way())
            way.times_s.append(time_s)
            way.places.append((user.x_m, user.y_m, user.z_m, user.yaw_rad))
        traffic.advance(time_s, ego, scenario.step_s)
    return found
