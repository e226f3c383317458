"""Pixel correspondence between two views: backward warp by depth, with an occlusion test."""

from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, UInt8

from ..datasets.geometry import intrinsics
from ..scene.camera import Camera
from .base import ClearView

_SHARE = 0.5  # threshold from which a pixel counts as a class or as sky
_SAME_MOMENT_S = 0.01
"""Largest time offset between a rig's cameras of one exposure; a car at 10 m/s moves 0.1 m in this time."""

_NOWHERE = -1.0
_ROUNDING_PX = 1e-6


class MatchOutcome(IntEnum):
    """Result of the search for one pixel."""

    MATCHED = 0
    UNKNOWN = 1
    """The depth is unknown in either view."""
    OUTSIDE = 2
    """Beyond the other image's border or behind the other camera."""
    HIDDEN = 3
    """Occluded in the other view, or absent from it."""
    EDGE = 4
    """On a depth edge in either view, so the color is a mixture."""
    MOVING = 5
    """Part of a vehicle, with views from different times."""


@dataclass(frozen=True, slots=True, eq=False)
class Correspondence:
    """Position in another view of each pixel of a view."""

    places: Float32[np.ndarray, "h w 2"]
    """Column and row in the other image, whose first pixel has its center at (0.5, 0.5); (-1, -1) behind the other
    camera or at unknown depth. Only positions of matched pixels show the same point."""
    outcome: UInt8[np.ndarray, "h w"]
    """`MatchOutcome` of each pixel."""
    size: tuple[int, int]
    """Height and width of the other image."""

    @property
    def valid(self) -> Bool[np.ndarray, "h w"]:
        return self.outcome == MatchOutcome.MATCHED

    def at(
        self, height: int, width: int
    ) -> tuple[Float32[np.ndarray, "{height} {width} 2"], Bool[np.ndarray, "{height} {width}"]]:
        """Return the warp for a feature map over the image, as `grid_sample` takes it with align_corners=False.

        A cell is valid if at least half of its area is. The offset between both views, in shares of each image, is
        averaged over the valid part, so that warping a view onto itself is the exact identity. Invalid cells point
        outside, at (-2, -2).
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


# Depth tolerance and matching. Meters along the view axis.


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """Largest difference between two depths of one point: the larger of `distance_m` and `share` of the depth."""

    distance_m: float = 0.05
    share: float = 0.02
    edges: bool = True
    """Skip pixels on depth edges, which mix the depth and color of two surfaces."""


def correspondence(of: ClearView, to: ClearView, tolerance: Tolerance | None = None) -> Correspondence:
    """Find each pixel of a view in another one: (13)-(15) of the paper as a backward warp, which leaves no holes.

    Each pixel is unprojected by its depth and projected into the other image; it matches if the depth there equals its
    distance. The sky is infinitely far away and only matches sky. Vehicles match only if both views have the same time.
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

    outcome = np.full(of.depth.shape, MatchOutcome.MATCHED, np.uint8)
    outcome[inside & ~seen.agrees(depth, here.is_sky, tolerance)] = MatchOutcome.HIDDEN
    if tolerance.edges:
        outcome[here.edges | (inside & seen.edge)] = MatchOutcome.EDGE
    if abs(of.time_s - to.time_s) > _SAME_MOMENT_S:
        outcome[(of.vehicles > _SHARE) | (inside & _share_at(to.vehicles, safe))] = MatchOutcome.MOVING
    outcome[inside & ~seen.known] = MatchOutcome.UNKNOWN
    outcome[~inside] = MatchOutcome.OUTSIDE
    outcome[~here.known] = MatchOutcome.UNKNOWN
    shown = np.where(in_front[..., None], np.clip(places, -1e6, 1e6), _NOWHERE)
    return Correspondence(shown.astype(np.float32), outcome, (height, width))


def warped(image: Float32[np.ndarray, "h w c"], correspondence: Correspondence) -> Float32[np.ndarray, "h2 w2 c"]:
    """Warp the other view's image into this view, bilinearly; 0 at unmatched pixels."""
    places = np.where(correspondence.valid[..., None], correspondence.places, 0.5).astype(np.float32)
    shown = sampled(image, places)
    return np.where(correspondence.valid[..., None], shown, 0).astype(np.float32)


def _share_at(share: Float32[np.ndarray, "h w"], places: Float32[np.ndarray, "h2 w2 2"]) -> Bool[np.ndarray, "h2 w2"]:
    return sampled(share[..., None], places)[..., 0] > _SHARE


def _area_mean(values: Float32[np.ndarray, "h w c"], height: int, width: int) -> Float64[np.ndarray, "h2 w2 c"]:
    smaller = height <= values.shape[0] and width <= values.shape[1]
    how = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(values, (width, height), interpolation=how), np.float64)


_EDGE = 0.05
"""Inverse depth of a plane is linear in the image: a bend from one pixel to the next above this share of it is an
edge."""

_SPARSE = 0.25  # depth with a smaller share of known pixels is sparse lidar
_MAX_REACH_PX = 12
_SPARSE_SHARE = 0.1  # relative depth difference allowed between a pixel and the nearest lidar point around it
_FAR = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class DepthSample:
    """Depth of a view, sampled at given positions."""

    depth: Float64[np.ndarray, "h w"]
    """Infinite in the sky."""
    known: Bool[np.ndarray, "h w"]
    sky: Bool[np.ndarray, "h w"]
    edge: Bool[np.ndarray, "h w"]
    slack: float
    """Additional tolerance, as a share of the distance."""

    def agrees(
        self, depth: Float64[np.ndarray, "h w"], is_sky: Bool[np.ndarray, "h w"], tolerance: Tolerance
    ) -> Bool[np.ndarray, "h w"]:
        """Mask of samples at the given depth; sky only agrees with sky."""
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

    def at(self, places: Float32[np.ndarray, "h2 w2 2"]) -> DepthSample:
        """Sample positions inside the image, at least half a pixel from its border."""
        return self._sparse_at(places) if self.is_sparse else self._dense_at(places)

    def _dense_at(self, places: Float32[np.ndarray, "h2 w2 2"]) -> DepthSample:
        maps = np.stack([self.inverse_depth, self.known, self.is_sky, self.edges], axis=2).astype(np.float32)
        inverse, known, sky, edge = np.moveaxis(sampled(maps, places), 2, 0)
        with np.errstate(divide="ignore"):
            depth = 1.0 / inverse.astype(np.float64)
        return DepthSample(depth, known > 0.999, sky > 0.999, edge > 0.001, 0.0)

    def _sparse_at(self, places: Float32[np.ndarray, "h2 w2 2"]) -> DepthSample:
        columns, rows = np.moveaxis(places.astype(np.int64), 2, 0)
        sky = self.is_sky[rows, columns]
        nearest = self._nearest[rows, columns]
        depth = np.where(nearest < _FAR, nearest, np.inf)
        return DepthSample(depth, sky | (nearest < _FAR), sky, np.zeros(sky.shape, bool), _SPARSE_SHARE)


def _nearest_around(depth: Float32[np.ndarray, "h w"], density: float) -> Float64[np.ndarray, "h w"]:
    """Smallest depth in a window that holds about four measured pixels."""
    reach = min(int(np.ceil(1 / np.sqrt(density))), _MAX_REACH_PX)
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


# Reprojection. Cameras in the world, depth along the view axis.


def reprojected(
    inverse_depth: Float[np.ndarray, "h w"], of: Camera, to: Camera
) -> tuple[Float64[np.ndarray, "h w 2"], Float64[np.ndarray, "h w"]]:
    """Return column and row in the other camera (first center at 0.5), and depth there in meters, of each pixel.

    Equations (13)-(15) of the paper divided by depth: with w = 1/d, (x, y, z)/d = K' R' R^-1 K^-1 (u, v, 1) + w K' t.
    Inverse depth 0 is infinitely far away, where only the rotation counts; its depth is infinite. Depth is 0 or less
    behind the other camera.
    """
    turn = to.world_to_camera[:3, :3] @ of.world_to_camera[:3, :3].T
    shift = to.world_to_camera[:3, 3] - turn @ of.world_to_camera[:3, 3]
    k_to = intrinsics(to)
    columns = (np.arange(of.width) + 0.5 - of.cx) / of.fx
    rows = (np.arange(of.height) + 0.5 - of.cy) / of.fy
    along = k_to @ turn
    moved = k_to @ shift
    x, y, z = (
        along[i, 0] * columns[None] + (along[i, 1] * rows + along[i, 2])[:, None] + moved[i] * inverse_depth
        for i in range(3)
    )
    ahead = z > 1e-9
    divisor = np.where(ahead, z, 1.0)
    places = np.stack([x / divisor, y / divisor], axis=2)
    with np.errstate(divide="ignore"):
        depth = np.where(ahead, z / np.maximum(inverse_depth, 0), -1.0)
    return places, depth


# Sampling. The first pixel has its center at (0.5, 0.5).


def sampled(
    image: Float[np.ndarray, "h w c"], places: Float32[np.ndarray, "h2 w2 2"]
) -> Float32[np.ndarray, "h2 w2 c"]:
    """Values at columns and rows of an image, bilinear (OpenCV: to 1/32 pixel); the border is replicated outside."""
    maps = places - np.float32(0.5)
    pixels = np.ascontiguousarray(image, np.float32)
    found = cv2.remap(pixels, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.float32).reshape(*places.shape[:2], image.shape[2])


# Colors of outcomes

COLORS: dict[MatchOutcome, tuple[float, float, float]] = {
    MatchOutcome.MATCHED: (0.25, 0.8, 0.45),
    MatchOutcome.HIDDEN: (0.9, 0.25, 0.25),
    MatchOutcome.EDGE: (0.95, 0.75, 0.2),
    MatchOutcome.MOVING: (0.65, 0.4, 0.95),
    MatchOutcome.UNKNOWN: (0.55, 0.57, 0.62),
    MatchOutcome.OUTSIDE: (0.0, 0.0, 0.0),
}
"""Display colors 0..1, in the order of the legend."""
