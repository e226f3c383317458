"""Surfaces cut into cells: fine where a colour ends, coarse in between."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float64

from .labels import Label
from .quads import EDGE_SPREAD, INNER_SPREAD, Quads

GROWTH = 2.1
"""How much wider a cell may be than its neighbour nearer to the edge."""


def even_lines(start: float, stop: float, spacing: float) -> Float64[np.ndarray, " n"]:
    """Grid lines of equal distance, at most `spacing`."""
    return np.linspace(start, stop, max(1, round(np.ceil(abs(stop - start) / spacing - 1e-6))) + 1)


def graded_lines(breaks: Sequence[float | int], edge: float, coarse: float) -> Float64[np.ndarray, " n"]:
    """Grid lines that hit every break, `edge` apart there and up to `coarse` in the middle between breaks."""
    parts = [np.array(breaks[:1], np.float64)]
    for start, stop in pairwise(breaks):
        parts.append(start + _graded(stop - start, edge, coarse)[1:])
    return np.concatenate(parts)


def _graded(length: float, edge: float, coarse: float) -> Float64[np.ndarray, " n"]:
    """Lines from 0 to `length` whose distances grow from both ends towards the middle."""
    if length <= 2.5 * edge:
        return np.linspace(0, length, 2 if length <= 1.3 * edge else 3)
    steps: list[float] = []
    step, reached = edge, 0.0
    while reached + step < 0.5 * length and step < coarse:
        steps.append(step)
        reached += step
        step = min(step * GROWTH, coarse)
    middle = max(1, round((length - 2 * reached) / step))
    widths = np.array([*steps, *[(length - 2 * reached) / middle] * middle, *steps[::-1]])
    return np.concatenate([[0.0], np.cumsum(widths)])


def panel(
    origin: Sequence[float | int],
    u_axis: Sequence[float | int],
    v_axis: Sequence[float | int],
    u_lines: Float64[np.ndarray, " i"],
    v_lines: Float64[np.ndarray, " j"],
    albedo: Any,
    label: Label,
    **more: Any,
) -> Quads:
    """Cut a flat rectangle into cells; it faces u x v. `more` goes to `Quads.of`."""
    u, v = np.asarray(u_axis, np.float64), np.asarray(v_axis, np.float64)
    points = np.asarray(origin, np.float64) + u_lines[:, None, None] * u + v_lines[None, :, None] * v
    return patch(points, albedo, label, **more)


def patch(
    points: Float[np.ndarray, "i j 3"],
    albedo: Any,
    label: Label,
    *,
    keep: Bool[np.ndarray, "a b"] | None = None,
    closed: bool = False,
    **more: Any,
) -> Quads:
    """Make a cell of each mesh of a grid of points; u runs along the first index. It faces u x v.

    `keep` leaves cells out; `closed` says that the last row of points is the first one again (no edge there).
    """
    corners = np.stack([points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]], axis=2)
    i, j = corners.shape[:2]
    spread = np.full((i, j, 2), INNER_SPREAD)
    if not closed:
        spread[[0, -1], :, 0] = EDGE_SPREAD
    spread[:, [0, -1], 1] = EDGE_SPREAD
    quads = Quads.of(corners.reshape(-1, 4, 3), albedo, label, **{"spread": spread.reshape(-1, 2), **more})
    return quads if keep is None else quads.take(keep.reshape(-1))


def box(
    center: Sequence[float | int],
    size: Sequence[float | int],
    albedo: Any,
    label: Label,
    *,
    edge: float = 0.03,
    coarse: float = 0.4,
    faces: str = "xXyYZ",
    **more: Any,
) -> Quads:
    """Cut the faces of an upright box into cells. `faces`: x is the face at -x, X the one at +x, and so on."""
    half = [0.5 * float(s) for s in size]
    low = [float(c) - h for c, h in zip(center, half, strict=True)]
    high = [float(c) + h for c, h in zip(center, half, strict=True)]
    x, y, z = (graded_lines([0.0, 2 * h], edge, coarse) for h in half)
    ex, ey, ez = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    sides = {
        "x": (low, ez, ey, z, y),
        "X": ([high[0], low[1], low[2]], ey, ez, y, z),
        "y": (low, ex, ez, x, z),
        "Y": ([low[0], high[1], low[2]], ez, ex, z, x),
        "z": (low, ey, ex, y, x),
        "Z": ([low[0], low[1], high[2]], ex, ey, x, y),
    }
    return Quads.joined(panel(*sides[face], albedo, label, **more) for face in faces)


def tube(
    path: Float[np.ndarray, "i 3"],
    radii: Float[np.ndarray, " i"],
    albedo: Any,
    label: Label,
    *,
    sides: int = 8,
    **more: Any,
) -> Quads:
    """Make a round pole along a path, open at its ends."""
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    reference = np.where(np.abs(along[:, 2:]) > 0.9, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    first = np.cross(reference, along)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(along, first)
    angles = np.linspace(0, 2 * np.pi, sides + 1)[:, None, None]
    rings = np.cos(angles) * first + np.sin(angles) * second
    points = path[None] + radii[None, :, None] * rings
    ends = np.zeros((sides, len(path) - 1))
    ends[:, [0, -1]] = EDGE_SPREAD - INNER_SPREAD
    # Few and strongly bent cells: narrow Gaussians around, or the pole would look thicker than it is.
    spread = np.stack([np.full_like(ends, EDGE_SPREAD), INNER_SPREAD + ends], axis=2).reshape(-1, 2)
    return patch(points, albedo, label, closed=True, **{"spread": spread, **more})
