"""What the ego vehicle really drove into."""

from typing import NamedTuple

import numpy as np

from ..rollouts.rollout import Rollout


class Collision(NamedTuple):
    """The first touch of a run."""

    who: str
    """Id of the road user, "background" for anything else."""
    time_s: float
    """Since the scenario began."""
    speed_m_s: float
    """Of the ego vehicle, at the first moment at which they touch."""
    closing_speed_m_s: float
    """How fast it came nearer along its own heading: less than its speed where the other drives on ahead."""


def first_collision(rollout: Rollout) -> Collision | None:
    """Return the first touch of the vehicle's box on the ground with another's or the background; None without one.

    The boxes are those of the simulation, judged at every step, so that times are multiples of it.
    """
    for step in rollout.steps:
        if step.collision is not None:
            other = next((each for each in step.road_users if each.id == step.collision), None)
            away = 0.0 if other is None else other.speed_m_s * float(np.cos(other.yaw_rad - step.ego.yaw_rad))
            return Collision(step.collision, step.time_s, step.ego.speed_m_s, step.ego.speed_m_s - away)
    return None
