"""How other road users move: one rule each, made anew for every run."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from ..road.route import Route
from .road_user import RoadUser


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What a road user knows when it decides where to be next: all as it is now, before anybody has moved."""

    time_s: float
    """Since the scenario began."""
    ego: RoadUser
    others: tuple[RoadUser, ...]
    """Everybody else but itself, who is there now."""
    route: Route
    """The ego vehicle's way, which stands for the road."""


@runtime_checkable
class Behaviour(Protocol):
    """Moves one road user. Deterministic: it knows the surroundings and what it did before, no clock and no chance."""

    def start(self, placed: RoadUser) -> RoadUser | None:
        """Return where it is at the beginning: where the scenario places it, if it has no place of its own."""
        ...

    def next(self, me: RoadUser | None, around: Surroundings, dt_s: float) -> RoadUser | None:
        """Return where it is a time later; None while it is not there, before it comes and after it has gone."""
        ...
