"""Depth that lidar points have in a view: sparse, and without those that nearer surfaces hide from the camera."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from ..capture import Sweep, View
from .lens_projection import project_points

BEAM_GAP_DEG = (0.6, 1.5)
"""Largest gap between neighbouring beams that is bridged, across and up: that of a lidar with 32 beams."""
_NEARER_PART, _NEARER_M = 0.05, 0.3
_NEAREST_M = 0.1


def lidar_depth(view: View, sweeps: Sequence[Sweep]) -> Float32[np.ndarray, "h w"]:
    """Metres along the view axis where points fall, the nearest of a pixel; 0 elsewhere. A lens is taken into account.

    The lidar stands elsewhere than the camera and sees past things that hide what is behind: a point with nearer
    points around it, in three of the four quadrants within the gaps between beams, is taken for hidden.
    """
    nearest = _nearest(view, [sweep.points_m for sweep in sweeps], _NEAREST_M)
    nearest[_hidden(nearest, view)] = np.inf
    return np.where(np.isfinite(nearest), nearest, 0).astype(np.float32)


def point_depth(view: View, points: Float[np.ndarray, "p 3"]) -> Float32[np.ndarray, "h w"]:
    """Depth along the view axis, in the world's unit, of the nearest point in each pixel; 0 where there is none."""
    nearest = _nearest(view, [points], 0.0)
    return np.where(np.isfinite(nearest), nearest, 0).astype(np.float32)


def _nearest(view: View, clouds: Sequence[Float[np.ndarray, "_ 3"]], from_depth: float) -> Float32[np.ndarray, "h w"]:
    size = (view.camera.height, view.camera.width)
    nearest = np.full(size, np.inf, np.float32)
    for cloud in clouds:
        pixels, depths = project_points(cloud, view.camera, view.lens)
        rows, columns, inside = pixels_inside(pixels, size)
        kept = inside & (depths > from_depth)
        np.minimum.at(nearest, (rows[kept], columns[kept]), depths[kept].astype(np.float32))
    return nearest


def pixels_inside(
    pixels: Float64[np.ndarray, "p 2"], size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, Bool[np.ndarray, " p"]]:
    """Rows and columns of pixels (0 where outside), and which lie inside a picture of (height, width)."""
    with np.errstate(invalid="ignore"):
        inside = (pixels >= 0).all(axis=1) & (pixels[:, 0] < size[1]) & (pixels[:, 1] < size[0])
    whole = np.where(inside[:, None], pixels, 0).astype(np.int64)
    return whole[:, 1], whole[:, 0], inside


def nearest_sweep(view: View, sweeps: Sequence[Sweep]) -> Sweep | None:
    return min(sweeps, key=lambda sweep: abs(sweep.time_s - view.time_s), default=None)


def _hidden(nearest: Float32[np.ndarray, "h w"], view: View) -> Bool[np.ndarray, "h w"]:
    """Which points have nearer ones in three of the four quadrants; the own row, where a road's points mix, is none."""
    across, up = np.tan(np.radians(BEAM_GAP_DEG))
    columns = max(round(view.camera.fx * across), 1) + 1
    rows = max(round(view.camera.fy * up), 1)
    window = np.ones((rows, columns), np.uint8)
    edge = np.full((1, nearest.shape[1]), np.inf, np.float32)
    above, below = np.concatenate([edge, nearest[:-1]]), np.concatenate([nearest[1:], edge])
    far_enough = nearest * (1 - _NEARER_PART) - _NEARER_M
    around = np.zeros(nearest.shape, np.uint8)
    for beside, anchor_row in ((above, rows - 1), (below, 0)):
        for anchor_column in (0, columns - 1):
            least = cv2.erode(beside, window, anchor=(anchor_column, anchor_row), borderValue=np.inf)
            around += least < far_enough
    return (around >= 3) & np.isfinite(nearest)
