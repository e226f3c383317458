"""Colours of points from the pictures that see them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from gsrain_engine.datasets.capture import View
from gsrain_engine.scene.camera import Camera

_NEAR = 0.05
_HIDDEN = 1.06
"""A point so many times farther than the surface in its pixel is behind it."""
_SLACK = 0.15
"""What is added to that, in the world's unit: points on thin things and edges."""


def projected(
    points: Float32[np.ndarray, "p 3"] | Float64[np.ndarray, "p 3"], camera: Camera
) -> tuple[Int64[np.ndarray, " m"], Int64[np.ndarray, " m"], Int64[np.ndarray, " m"], Float64[np.ndarray, " m"]]:
    """Index of each point that falls into the picture, its row and column there, and its depth."""
    seen = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    ahead = np.flatnonzero(seen[:, 2] > _NEAR)
    z = seen[ahead, 2]
    column = np.floor(seen[ahead, 0] / z * camera.fx + camera.cx)
    row = np.floor(seen[ahead, 1] / z * camera.fy + camera.cy)
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    return ahead[inside], row[inside].astype(np.int64), column[inside].astype(np.int64), z[inside].astype(np.float64)


def point_colors(
    points: Float32[np.ndarray, "p 3"] | Float64[np.ndarray, "p 3"],
    views: Sequence[View],
    depths: Sequence[Float32[np.ndarray, "_ _"]],
    most_views: int = 8,
) -> tuple[Float32[np.ndarray, "p 3"], Bool[np.ndarray, " p"]]:
    """Display colour of each point, the median over the nearest views that see it, and whether any does (else grey).

    Args:
        points: In the world of the capture.
        views: Without distortion; pixels outside their masks tell nothing.
        depths: Of the surface in each pixel, which hides what is behind it; 0 hides nothing.
        most_views: Of those that see a point, so many of the nearest count.
    """
    nearest = np.full((len(points), most_views), np.inf)
    samples = np.full((len(points), most_views, 3), np.nan, np.float32)
    for view, depth in zip(views, depths, strict=True):
        index, row, column, z = projected(points, view.camera)
        surface = depth[row, column]
        seen = (surface <= 0) | (z <= surface * _HIDDEN + _SLACK)
        mask = view.mask
        if mask is not None:
            seen &= mask[row, column]
        index, row, column, z = index[seen], row[seen], column[seen], z[seen]
        slot = nearest[index].argmax(axis=1)
        nearer = z < nearest[index, slot]
        index, slot = index[nearer], slot[nearer]
        nearest[index, slot] = z[nearer]
        samples[index, slot] = view.image[row[nearer], column[nearer]].astype(np.float32) / 255
    known = np.asarray(np.isfinite(nearest).any(axis=1))
    colors = np.full((len(points), 3), 0.5, np.float32)
    colors[known] = np.nanmedian(samples[known], axis=1)
    return colors, known
