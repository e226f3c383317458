"""A road user that does again what one did in a roll-out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import numpy as np
from jaxtyping import Float64
from msgspec import Meta

from ..angles import wrapped
from ..rollouts.driven_vehicle import driven_vehicle
from ..rollouts.files import read_any_rollout
from ..rollouts.rollout import Rollout
from ..vehicle.body import vehicle_box
from ..vehicle.state import VehicleState
from .behaviour import Behaviour
from .by_the_clock import ByTheClock
from .ego_user import EGO
from .road_user import RoadUser

if TYPE_CHECKING:
    from gsrain_engine.scene.scene import Scene


class Replay(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="replay"):
    """Moves as one road user of a finished drive did, or as its ego vehicle; linear between its moments."""

    rollout: Annotated[str, Meta(min_length=1, title="Roll-out", description="A roll-out file (JSON lines).")]
    user: Annotated[
        str, Meta(min_length=1, title="Road user", description='Its id in the roll-out; "ego" is its ego vehicle.')
    ]

    def begin(self, scene: "Scene", start_s: float) -> Behaviour:
        """Make the rule for one run; raises ValueError where there is no such file or nobody of that name in it."""
        path = Path(self.rollout)
        if not path.is_file():
            raise ValueError(f"{path}: no such roll-out")
        moments = _moments(read_any_rollout(path), self.user)
        if not len(moments):
            raise ValueError(f"{path}: nobody is called {self.user!r} in this roll-out")
        return _Again(moments)


def _moments(rollout: Rollout, user: str) -> Float64[np.ndarray, "n 5"]:
    """Time, x, y, heading and speed of a road user's middle, moment by moment; NaN while it is not there."""
    rows: list[tuple[float, ...]] = []
    absent = (float("nan"),) * 4
    vehicle = driven_vehicle(rollout)
    for step in rollout.steps:
        if user == EGO:
            box = vehicle_box(vehicle, VehicleState(step.ego.x_m, step.ego.y_m, step.ego.yaw_rad))
            rows.append((step.time_s, box.x_m, box.y_m, box.yaw_rad, step.ego.speed_m_s))
            continue
        here = next((each for each in step.road_users if each.id == user), None)
        place = absent if here is None else (here.x_m, here.y_m, here.yaw_rad, here.speed_m_s)
        rows.append((step.time_s, *place))
    moments = np.array(rows)
    return moments if np.isfinite(moments).all(axis=1).any() else moments[:0]


class _Again(ByTheClock):
    def __init__(self, moments: Float64[np.ndarray, "n 5"]) -> None:
        self._moments = moments

    def _at(self, me: RoadUser, time_s: float) -> RoadUser | None:
        """Where it was at a time; after the roll-out's end it stands where it ended."""
        times = self._moments[:, 0]
        later = int(np.searchsorted(times, time_s - 1e-9))
        if later >= len(times):
            return _moved(me, self._moments[-1] * [1, 1, 1, 1, 0])
        earlier = max(later - 1, 0)
        span = times[later] - times[earlier]
        share = (time_s - times[earlier]) / span if span > 0 else 1.0
        first, last = self._moments[earlier], self._moments[later].copy()
        if share > 1 - 1e-9:
            return _moved(me, last)
        last[3] = first[3] + wrapped(float(last[3] - first[3]))
        return _moved(me, (1 - share) * first + share * last)


def _moved(me: RoadUser, moment: Float64[np.ndarray, "5"]) -> RoadUser | None:
    if not np.isfinite(moment).all():
        return None
    _, x, y, yaw, speed = (float(value) for value in moment)
    return me.moved(x_m=x, y_m=y, yaw_rad=yaw, speed_m_s=speed)
