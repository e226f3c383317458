"""Which pixel of another view shows the same place: a backward warp by depth, with a test of what hides it."""

from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from ..clear_view import ClearView
from .depth_lookup import DepthLookup, Tolerance
from .reprojection import reprojected
from .sampling import sampled

_SHARE = 0.5
"""Of a class or of the sky, from which on a pixel counts as one."""

_SAME_MOMENT_S = 0.01
"""Cameras of a rig are released together within so much; a car of 10 m/s moves by 0.1 m meanwhile."""

_NOWHERE = -1.0
_ROUNDING_PX = 1e-6


class Outcome(IntEnum):
    """What became of a pixel."""

    MATCHED = 0
    UNKNOWN = 1
    """Nobody knows how far away it is, here or there."""
    OUTSIDE = 2
    """The other picture ends before it, or it lies behind the other camera."""
    HIDDEN = 3
    """Something else stands before it there, or it is not there."""
    EDGE = 4
    """It lies on the edge of something, here or there: its colour is a mixture."""
    MOVING = 5
    """A vehicle, seen at another moment."""


@dataclass(frozen=True, slots=True, eq=False)
class Correspondence:
    """For each pixel of one view its place in another one."""

    places: Float32[np.ndarray, "h w 2"]
    """Column and row in the other picture, whose first pixel has its centre at (0.5, 0.5); (-1, -1) where it is behind
    the other camera or its distance is not known. Only those of matched pixels mean the same place."""
    outcome: UInt8[np.ndarray, "h w"]
    """`Outcome` of each pixel."""
    size: tuple[int, int]
    """Height and width of the other picture."""

    @property
    def valid(self) -> Bool[np.ndarray, "h w"]:
        """Which pixels have a place in the other picture that shows the same."""
        return self.outcome == Outcome.MATCHED

    def at(
        self, height: int, width: int
    ) -> tuple[Float32[np.ndarray, "{height} {width} 2"], Bool[np.ndarray, "{height} {width}"]]:
        """Return the warp for a map of features over the picture, as `grid_sample` takes it with align_corners=False.

        A cell is valid where at least half of its area is. What is averaged over the valid part is the way from here to
        there, in shares of both pictures, so that a view warped onto itself stays where it is, to the last bit. Cells
        that are not valid point outside, at (-2, -2).
        """
        valid = self.valid
        own_y, own_x = (np.arange(n, dtype=np.float64) + 0.5 for n in valid.shape)
        way_x = self.places[..., 0] / self.size[1] - own_x / valid.shape[1]
        way_y = self.places[..., 1] / self.size[0] - (own_y / valid.shape[0])[:, None]
        stacked = np.stack([way_x * valid, way_y * valid, valid], axis=2).astype(np.float32)
        coarse = _area_mean(stacked, height, width)
        share = coarse[..., 2]
        is_valid = share >= _SHARE - 1e-6
        way = coarse[..., :2] / np.maximum(share, 1e-6)[..., None]
        rows, columns = ((2 * np.arange(n) + 1) / n - 1 for n in (height, width))
        centers = np.stack(np.broadcast_arrays(columns[None], rows[:, None]), axis=2)
        grid = np.where(is_valid[..., None], centers + 2 * way, -2.0)
        return grid.astype(np.float32), is_valid


def correspondence(of: ClearView, to: ClearView, tolerance: Tolerance | None = None) -> Correspondence:
    """Find each pixel of a view in another one: (13)-(15) of the paper, taken backwards, so that no hole is left.

    A pixel is carried into the world by its depth and into the other picture, and it is matched where that picture's
    own depth there is its distance. The sky is infinitely far away and only matches sky. Vehicles match only where both
    views were taken at one moment.
    """
    tolerance = tolerance or Tolerance()
    here, there = DepthLookup(of), DepthLookup(to)
    places, depth = reprojected(here.inverse_depth, of.camera, to.camera)
    height, width = to.camera.height, to.camera.width
    x, y = places[..., 0], places[..., 1]
    in_front = here.known & (depth > 0)
    low, right, bottom = 0.5 - _ROUNDING_PX, width - 0.5 + _ROUNDING_PX, height - 0.5 + _ROUNDING_PX
    inside = in_front & (x >= low) & (y >= low) & (x <= right) & (y <= bottom)
    safe = np.where(inside[..., None], places, 0.5).astype(np.float32)
    seen = there.at(safe)

    outcome = np.full(of.depth.shape, Outcome.MATCHED, np.uint8)
    outcome[inside & ~seen.agrees(depth, here.is_sky, tolerance)] = Outcome.HIDDEN
    if tolerance.edges:
        outcome[here.edges | (inside & seen.edge)] = Outcome.EDGE
    if abs(of.time_s - to.time_s) > _SAME_MOMENT_S:
        outcome[(of.vehicles > _SHARE) | (inside & _share_at(to.vehicles, safe))] = Outcome.MOVING
    outcome[inside & ~seen.known] = Outcome.UNKNOWN
    outcome[~inside] = Outcome.OUTSIDE
    outcome[~here.known] = Outcome.UNKNOWN
    shown = np.where(in_front[..., None], np.clip(places, -1e6, 1e6), _NOWHERE)
    return Correspondence(shown.astype(np.float32), outcome, (height, width))


def warped(image: Float32[np.ndarray, "h w c"], correspondence: Correspondence) -> Float32[np.ndarray, "h2 w2 c"]:
    """Show the other view's picture from this one; 0 where it has no valid place. Bilinear between pixels."""
    places = np.where(correspondence.valid[..., None], correspondence.places, 0.5).astype(np.float32)
    shown = sampled(image, places)
    return np.where(correspondence.valid[..., None], shown, 0).astype(np.float32)


def _share_at(share: Float32[np.ndarray, "h w"], places: Float32[np.ndarray, "h2 w2 2"]) -> Bool[np.ndarray, "h2 w2"]:
    return sampled(share[..., None], places)[..., 0] > _SHARE


def _area_mean(values: Float32[np.ndarray, "h w c"], height: int, width: int) -> Float64[np.ndarray, "h2 w2 c"]:
    smaller = height <= values.shape[0] and width <= values.shape[1]
    how = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(values, (width, height), interpolation=how), np.float64)
