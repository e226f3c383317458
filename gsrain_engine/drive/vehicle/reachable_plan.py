"""What of a plan a vehicle can keep to that can't brake as hard as the plan does."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from .tracked_plan import SHORTEST_M, directions


class ReachablePlan(NamedTuple):
    """Points of a plan, none of them nearer than full braking leads."""

    points: Float64[np.ndarray, "n 2"]
    full_braking: bool
    """Whether even the last point is nearer: then nothing is left to weigh."""


def reachable(
    plan: Float64[np.ndarray, "n 2"], speed_m_s: float, braking_m_s2: float, spacing_s: float
) -> ReachablePlan:
    """Move what is too near on along the plan's own line, and straight on beyond its end.

    A tracker that is told to be where it has already driven past comes nearer to it by turning round: a driver who
    asks for a full stop at once would be steered off the road. A plan that stays within 0.1 m of the vehicle is such a
    stop, with noise. `plan` is in the vehicle's frame (x forward, y left).
    """
    if np.linalg.norm(plan, axis=1).max() < SHORTEST_M:
        plan = np.zeros_like(plan)
    line = np.concatenate([np.zeros((1, 2)), plan])
    steps = np.diff(line, axis=0)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
    times = np.minimum(spacing_s * np.arange(1, len(plan) + 1), speed_m_s / braking_m_s2)
    least = speed_m_s * times - 0.5 * braking_m_s2 * times**2
    near = along[1:] < least
    heading = float(directions(steps)[-1])
    beyond = np.maximum(least - along[-1], 0.0)[:, None] * (np.cos(heading), np.sin(heading))
    moved = np.stack([np.interp(least, along, line[:, axis]) for axis in range(2)], axis=1) + beyond
    return ReachablePlan(np.where(near[:, None], moved, plan), bool(near[-1]))
