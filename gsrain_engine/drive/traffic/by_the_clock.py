"""A road user whose place depends on the time alone, whatever happens around it."""

from .behaviour import Surroundings
from .road_user import RoadUser


class ByTheClock:
    """A `Behaviour`. A kind of it says in `_at` where the road user is at a time."""

    _me: RoadUser | None = None
    """As it was placed."""

    def start(self, placed: RoadUser) -> RoadUser | None:
        """Say where it begins; None where it is not there yet."""
        self._me = placed
        return self._at(placed, 0.0)

    def next(self, me: RoadUser | None, around: Surroundings, dt_s: float) -> RoadUser | None:
        """Say where it is after a step; None where it is not there."""
        return None if self._me is None else self._at(self._me, around.time_s + dt_s)

    def _at(self, me: RoadUser, time_s: float) -> RoadUser | None:
        """Return it (`me` is how it was placed) at a time since the scenario began."""
        raise NotImplementedError
