"""What other programs answer as a plan, checked before anything is steered by it."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from .agent import FARTHEST_M
from .client_error import ClientError

_MOST_POINTS = 1000


def plan_points(value: Any, who: str) -> Float64[np.ndarray, "n 2"]:
    """Return a plan: an array (N, 2) of any numbers, or a list of pairs, finite and near.

    Raises ClientError, with what `who` has sent instead.
    """
    if isinstance(value, list):
        rows: list[Any] = value
        if not all(_is_pair(row) for row in rows):
            raise ClientError(f"{who} sent a plan that is a list, but not of pairs of numbers")
        value = np.array([[float(each) for each in row] for row in rows], np.float64).reshape(-1, 2)
    if not isinstance(value, np.ndarray):
        raise ClientError(f"{who} sent a {type(value).__name__} for a plan, not an array of points (N, 2)")
    points = np.asarray(value, np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not 1 <= len(points) <= _MOST_POINTS:
        raise ClientError(f"{who} sent a plan of shape {points.shape}, not (N, 2) with N from 1 to {_MOST_POINTS}")
    if not np.isfinite(points).all():
        raise ClientError(f"{who} sent a plan with points that are not finite")
    if np.abs(points).max() > FARTHEST_M:
        raise ClientError(f"{who} sent a plan with points farther than {FARTHEST_M / 1000:g} km")
    return points


def _is_pair(row: Any) -> bool:
    if isinstance(row, np.ndarray):
        return row.shape == (2,)
    if not isinstance(row, list):
        return False
    pair: list[Any] = row
    return len(pair) == 2 and all(isinstance(each, int | float) and abs(each) < 1e300 for each in pair)
