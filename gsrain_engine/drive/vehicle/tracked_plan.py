"""What a tracker is to follow: a plan's points with the headings that they are to be passed with."""

from typing import Literal

import numpy as np
from jaxtyping import Float64

from ..angles import wrapped

HeadingReference = Literal["tangent", "hugsim"]

SHORTEST_M = 0.1
"""Between closer points a plan has no direction: it jitters around a place where it wants to stand."""


def tracked_states(plan: Float64[np.ndarray, "n 2"], reference: HeadingReference) -> Float64[np.ndarray, "points 5"]:
    """Return the present state and those at the points of a plan: x, y, heading, 0, 0.

    Vehicle frame (x forward, y left, metres), headings in radians, left positive; speed and steering are not asked
    for. The first is the vehicle itself: the origin.
    """
    states = np.zeros((len(plan) + 1, 5))
    states[1:, :2] = plan
    steps = np.diff(states[:, :2], axis=0)
    states[1:, 2] = _tangents(steps) if reference == "tangent" else _swapped(steps)
    return states


def directions(steps: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
    """Return where steps lead, unwrapped, radians from x.

    Where the plan stands or turns back it is the direction before, and x itself where there is none.
    """
    found = np.empty(len(steps))
    before = 0.0
    for i, (x, y) in enumerate(steps):
        turn = wrapped(float(np.arctan2(y, x)) - before)
        if np.hypot(x, y) >= SHORTEST_M and abs(turn) <= np.pi / 2:
            before += turn
        found[i] = before
    return found


def _tangents(steps: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
    """Headings at the points: half way between the steps before and after; at the last as if it went on turning."""
    found = directions(steps)
    turns = np.diff(found) if len(found) > 1 else np.zeros(1)
    return found + 0.5 * (np.concatenate([turns, turns[-1:]]) if len(found) > 1 else turns)


def _swapped(steps: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
    """HUGSIM's published heading: arctan2(forward, right) folded into +-90 degrees, right positive.

    Of a straight plan this is 90 degrees and not 0 (its pull request 57 mends it). Its sign is that of the sideways
    step, so that a hair to the left and to the right want opposite things.
    """
    right = np.arctan2(steps[:, 0], -steps[:, 1])
    right = np.where(right > np.pi / 2, right - np.pi, right)
    return -np.where(right < -np.pi / 2, right + np.pi, right)
