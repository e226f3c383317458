"""Where the other road users of a roll-out really were, at any time of it. World frame, metres."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..angles import wrapped
from ..road.planar_box import PlanarBox
from ..rollouts.rollout import Rollout, UserModel, UserRecord

_SAME_S = 1e-6


class LoggedTraffic:
    """Boxes of the road users over the time of a roll-out."""

    def __init__(self, rollout: Rollout) -> None:
        self._times = np.array([each.time_s for each in rollout.steps])
        self._records = [each.road_users for each in rollout.steps]
        self._users = rollout.users
        self._known: dict[float, tuple[PlanarBox, ...]] = {}

    def at(self, time_s: float) -> tuple[PlanarBox, ...]:
        """Return who was there at a time: between two moments in between, after the last where it was then.

        HUGSIM looks up futures in the same way (its steps of 0.25 s meet the 0.5 s of a plan), and uses the last moment
        for what lies beyond the end of the run.
        """
        key = round(float(np.clip(time_s, self._times[0], self._times[-1])), 9)
        if key not in self._known:
            self._known[key] = self._looked_up(key)
        return self._known[key]

    def _looked_up(self, time_s: float) -> tuple[PlanarBox, ...]:
        later = int(np.searchsorted(self._times, time_s - _SAME_S))
        if later == len(self._times):
            later -= 1
        if abs(self._times[later] - time_s) <= _SAME_S or later == 0:
            return user_boxes(self._records[later], self._users)
        share = (time_s - self._times[later - 1]) / (self._times[later] - self._times[later - 1])
        after = {each.id: each for each in self._records[later]}
        both = [each for each in self._records[later - 1] if each.id in after]
        between = [_between(each, after[each.id], float(share)) for each in both]
        return user_boxes(between, self._users)


def user_boxes(records: Sequence[UserRecord], users: Mapping[str, UserModel]) -> tuple[PlanarBox, ...]:
    """Return the boxes on the ground of road users at a moment, in their order."""
    return tuple(
        PlanarBox(each.x_m, each.y_m, each.yaw_rad, users[each.id].size_lwh_m[0], users[each.id].size_lwh_m[1])
        for each in records
    )


def _between(before: UserRecord, after: UserRecord, share: float) -> UserRecord:
    return UserRecord(
        id=before.id,
        x_m=before.x_m + share * (after.x_m - before.x_m),
        y_m=before.y_m + share * (after.y_m - before.y_m),
        z_m=before.z_m + share * (after.z_m - before.z_m),
        yaw_rad=before.yaw_rad + share * wrapped(after.yaw_rad - before.yaw_rad),
        speed_m_s=before.speed_m_s + share * (after.speed_m_s - before.speed_m_s),
    )
