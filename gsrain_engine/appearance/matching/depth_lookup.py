"""How far away a view's pixels are, between pixels too, without mixing near and far. Metres along the view axis."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from ..clear_view import ClearView
from .sampling import sampled

_EDGE = 0.05
"""Over a plane inverse depth is linear in the picture: a bend of more than this share of it, from one pixel to the
next, is the edge of something."""

_SPARSE = 0.25
"""Depth that fewer pixels than this share have was measured by a lidar, and not filled in."""

_MOST_REACH_PX = 12
_SPARSE_SHARE = 0.1
"""Of the distance, by which nearest lidar points around a pixel may differ from the pixel."""

_FAR = 1e9


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """How far two depths of one place may differ: by the larger of both."""

    distance_m: float = 0.05
    share: float = 0.02
    edges: bool = True
    """Whether pixels on depth edges are left out, where depth and colour are mixtures of two things."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What a view knows about places in its picture."""

    depth: Float64[np.ndarray, "h w"]
    """Infinite in the sky."""
    known: Bool[np.ndarray, "h w"]
    sky: Bool[np.ndarray, "h w"]
    edge: Bool[np.ndarray, "h w"]
    slack: float
    """Share of the distance that is allowed in addition."""

    def agrees(
        self, depth: Float64[np.ndarray, "h w"], is_sky: Bool[np.ndarray, "h w"], tolerance: Tolerance
    ) -> Bool[np.ndarray, "h w"]:
        """Whether what is seen is at this distance; of the sky whether it is sky."""
        allowed = np.maximum(tolerance.distance_m, max(tolerance.share, self.slack) * depth)
        with np.errstate(invalid="ignore"):  # infinity minus infinity: both are sky
            near = np.abs(depth - self.depth) <= allowed
        return np.where(is_sky, self.sky, near & np.isfinite(self.depth))


class DepthLookup:
    """A view's depth as inverse depth, in which planes are linear and the sky is 0."""

    def __init__(self, view: ClearView) -> None:
        self.is_sky: Bool[np.ndarray, "h w"] = view.sky > 0.5
        measured = np.isfinite(view.depth) & (view.depth > 0) & ~self.is_sky
        self.known: Bool[np.ndarray, "h w"] = measured | self.is_sky
        depth = np.where(measured, view.depth, 1.0)
        self.inverse_depth: Float64[np.ndarray, "h w"] = np.where(measured, 1.0 / depth, 0.0).astype(np.float64)
        ground = np.count_nonzero(~self.is_sky)
        density = np.count_nonzero(measured) / max(ground, 1)
        self.is_sparse = bool(0 < density < _SPARSE)
        self.edges: Bool[np.ndarray, "h w"] = np.zeros(self.known.shape, bool)
        if self.is_sparse:
            self._nearest = _nearest_around(np.where(measured, view.depth, _FAR), density)
        else:
            self.edges = _bends(self.inverse_depth, self.known)

    def at(self, places: Float32[np.ndarray, "h2 w2 2"]) -> Seen:
        """Look up places inside the picture, at least half a pixel from its border."""
        return self._sparse_at(places) if self.is_sparse else self._dense_at(places)

    def _dense_at(self, places: Float32[np.ndarray, "h2 w2 2"]) -> Seen:
        maps = np.stack([self.inverse_depth, self.known, self.is_sky, self.edges], axis=2).astype(np.float32)
        inverse, known, sky, edge = np.moveaxis(sampled(maps, places), 2, 0)
        with np.errstate(divide="ignore"):
            depth = 1.0 / inverse.astype(np.float64)
        return Seen(depth, known > 0.999, sky > 0.999, edge > 0.001, 0.0)

    def _sparse_at(self, places: Float32[np.ndarray, "h2 w2 2"]) -> Seen:
        columns, rows = np.moveaxis(places.astype(np.int64), 2, 0)
        sky = self.is_sky[rows, columns]
        nearest = self._nearest[rows, columns]
        depth = np.where(nearest < _FAR, nearest, np.inf)
        return Seen(depth, sky | (nearest < _FAR), sky, np.zeros(sky.shape, bool), _SPARSE_SHARE)


def _nearest_around(depth: Float32[np.ndarray, "h w"], density: float) -> Float64[np.ndarray, "h w"]:
    """Smallest depth in a window that holds about four measured pixels."""
    reach = min(int(np.ceil(1 / np.sqrt(density))), _MOST_REACH_PX)
    size = 2 * reach + 1
    return cv2.erode(depth.astype(np.float32), np.ones((size, size), np.uint8)).astype(np.float64)


def _bends(inverse: Float64[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    bent = np.zeros(known.shape, bool)
    for axis in (0, 1):
        values, is_known, found = (np.moveaxis(each, axis, 0) for each in (inverse, known, bent))
        before, here, after = values[:-2], values[1:-1], values[2:]
        bend = np.abs(before + after - 2 * here)
        step = bend > _EDGE * np.maximum(np.maximum(before, after), here)
        found[1:-1] |= step & is_known[:-2] & is_known[1:-1] & is_known[2:]
    return bent
