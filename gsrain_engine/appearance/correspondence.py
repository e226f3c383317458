"""Correspondence between views: backward warp by depth with an occlusion test, and ranking of covisible neighbors."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64, UInt8

from ..datasets.geometry import intrinsics
from ..scene.camera import Camera
from .base import ClearView, Image, Plane

Flags = Bool[np.ndarray, "h w"]
Values = Float64[np.ndarray, " n"]
_SHARE = 0.5  # threshold from which a pixel counts as a class or as sky
_SAME_MOMENT_S = 0.01
"""Largest time offset between a rig's cameras of one exposure; a car at 10 m/s moves 0.1 m in this time."""
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
    def valid(self) -> Flags:
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
        offset_x = self.places[..., 0] / self.size[1] - own_x / valid.shape[1]
        offset_y = self.places[..., 1] / self.size[0] - (own_y / valid.shape[0])[:, None]
        stacked = np.stack([offset_x * valid, offset_y * valid, valid], axis=2).astype(np.float32)
        method = cv2.INTER_AREA if height <= valid.shape[0] and width <= valid.shape[1] else cv2.INTER_LINEAR
        coarse = np.asarray(cv2.resize(stacked, (width, height), interpolation=method), np.float64)
        share = coarse[..., 2]
        is_valid = share >= _SHARE - 1e-6
        offset = coarse[..., :2] / np.maximum(share, 1e-6)[..., None]
        rows, columns = ((2 * np.arange(n) + 1) / n - 1 for n in (height, width))
        centers = np.stack(np.broadcast_arrays(columns[None], rows[:, None]), axis=2)
        grid = np.where(is_valid[..., None], centers + 2 * offset, -2.0)
        return grid.astype(np.float32), is_valid


# Matching. Depth in meters along the view axis.

_TOLERANCE_M, _TOLERANCE_SHARE = 0.05, 0.02
"""Largest difference between two depths of one point: the larger of a distance and a share of the depth."""


def correspondence(of: ClearView, to: ClearView, *, skips_edges: bool = True) -> Correspondence:
    """Find each pixel of a view in another one: (13)-(15) of the paper as a backward warp, which leaves no holes.

    Each pixel is unprojected by its depth and projected into the other image; it matches if the depth there equals its
    distance. The sky is infinitely far away and only matches sky. Vehicles match only if both views have the same time.
    Pixels on depth edges, which mix the depth and color of two surfaces, are skipped.
    """
    here, there = DepthLookup(of), DepthLookup(to)
    places, depth = reprojected(here.inverse_depth, of.camera, to.camera)
    height, width = to.camera.height, to.camera.width
    x, y = places[..., 0], places[..., 1]
    in_front = here.known & (depth > 0)
    low, right, bottom = 0.5 - _ROUNDING_PX, width - 0.5 + _ROUNDING_PX, height - 0.5 + _ROUNDING_PX
    inside = in_front & (x >= low) & (y >= low) & (x <= right) & (y <= bottom)
    safe = np.where(inside[..., None], places, 0.5).astype(np.float32)
    found = there.at(safe)

    outcome = np.full(of.depth.shape, MatchOutcome.MATCHED, np.uint8)
    outcome[inside & ~found.agrees(depth, here.is_sky)] = MatchOutcome.HIDDEN
    if skips_edges:
        outcome[here.edges | (inside & found.edge)] = MatchOutcome.EDGE
    if abs(of.time_s - to.time_s) > _SAME_MOMENT_S:
        vehicle = sampled(to.vehicles[..., None], safe)[..., 0] > _SHARE
        outcome[(of.vehicles > _SHARE) | (inside & vehicle)] = MatchOutcome.MOVING
    outcome[inside & ~found.known] = MatchOutcome.UNKNOWN
    outcome[~inside] = MatchOutcome.OUTSIDE
    outcome[~here.known] = MatchOutcome.UNKNOWN
    bounded = np.where(in_front[..., None], np.clip(places, -1e6, 1e6), -1.0)
    return Correspondence(bounded.astype(np.float32), outcome, (height, width))


def warped(image: Float32[np.ndarray, "h w c"], correspondence: Correspondence) -> Float32[np.ndarray, "h2 w2 c"]:
    """Warp the other view's image into this view, bilinearly; 0 at unmatched pixels."""
    valid = correspondence.valid[..., None]
    places = np.where(valid, correspondence.places, 0.5).astype(np.float32)
    return np.where(valid, sampled(image, places), 0).astype(np.float32)


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
    known: Flags
    sky: Flags
    edge: Flags
    slack: float
    """Additional tolerance, as a share of the distance."""

    def agrees(self, depth: Float64[np.ndarray, "h w"], is_sky: Flags) -> Flags:
        """Mask of samples at the given depth; sky only agrees with sky."""
        allowed = np.maximum(_TOLERANCE_M, max(_TOLERANCE_SHARE, self.slack) * depth)
        with np.errstate(invalid="ignore"):  # infinity minus infinity: both are sky
            near = np.abs(depth - self.depth) <= allowed
        return np.where(is_sky, self.sky, near & np.isfinite(self.depth))


class DepthLookup:
    """A view's depth as inverse depth, in which planes are linear and the sky is 0."""

    def __init__(self, view: ClearView) -> None:
        self.is_sky: Flags = view.sky > 0.5
        measured = np.isfinite(view.depth) & (view.depth > 0) & ~self.is_sky
        self.known: Flags = measured | self.is_sky
        depth = np.where(measured, view.depth, 1.0)
        self.inverse_depth: Float64[np.ndarray, "h w"] = np.where(measured, 1.0 / depth, 0.0).astype(np.float64)
        density = np.count_nonzero(measured) / max(np.count_nonzero(~self.is_sky), 1)
        self.is_sparse = bool(0 < density < _SPARSE)
        self.edges: Flags = np.zeros(self.known.shape, bool)
        if not self.is_sparse:
            self._find_edges()
            return
        # Smallest depth in a window that holds about four measured pixels.
        size = 2 * min(int(np.ceil(1 / np.sqrt(density))), _MAX_REACH_PX) + 1
        depth = np.where(measured, view.depth, _FAR).astype(np.float32)
        self._nearest = cv2.erode(depth, np.ones((size, size), np.uint8)).astype(np.float64)

    def _find_edges(self) -> None:
        for axis in (0, 1):
            values, known, edges = (np.moveaxis(each, axis, 0) for each in (self.inverse_depth, self.known, self.edges))
            before, here, after = values[:-2], values[1:-1], values[2:]
            bend = np.abs(before + after - 2 * here)
            step = bend > _EDGE * np.maximum(np.maximum(before, after), here)
            edges[1:-1] |= step & known[:-2] & known[1:-1] & known[2:]

    def at(self, places: Float32[np.ndarray, "h2 w2 2"]) -> DepthSample:
        """Sample positions inside the image, at least half a pixel from its border."""
        if self.is_sparse:
            columns, rows = np.moveaxis(places.astype(np.int64), 2, 0)
            sky, nearest = self.is_sky[rows, columns], self._nearest[rows, columns]
            depth = np.where(nearest < _FAR, nearest, np.inf)
            return DepthSample(depth, sky | (nearest < _FAR), sky, np.zeros(sky.shape, bool), _SPARSE_SHARE)
        maps = np.stack([self.inverse_depth, self.known, self.is_sky, self.edges], axis=2).astype(np.float32)
        inverse, known, sky, edge = np.moveaxis(sampled(maps, places), 2, 0)
        with np.errstate(divide="ignore"):
            depth = 1.0 / inverse.astype(np.float64)
        return DepthSample(depth, known > 0.999, sky > 0.999, edge > 0.001, 0.0)


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
    columns = (np.arange(of.width) + 0.5 - of.cx) / of.fx
    rows = (np.arange(of.height) + 0.5 - of.cy) / of.fy
    along, moved = intrinsics(to) @ turn, intrinsics(to) @ shift
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


def sampled(
    image: Float[np.ndarray, "h w c"], places: Float32[np.ndarray, "h2 w2 2"]
) -> Float32[np.ndarray, "h2 w2 c"]:
    """Values at columns and rows of an image, whose first pixel has its center at (0.5, 0.5).

    Bilinear (OpenCV: to 1/32 pixel); the border is replicated outside.
    """
    maps = places - np.float32(0.5)
    pixels = np.ascontiguousarray(image, np.float32)
    found = cv2.remap(pixels, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.float32).reshape(*places.shape[:2], image.shape[2])


COLORS: dict[MatchOutcome, tuple[float, float, float]] = {
    MatchOutcome.MATCHED: (0.25, 0.8, 0.45),
    MatchOutcome.HIDDEN: (0.9, 0.25, 0.25),
    MatchOutcome.EDGE: (0.95, 0.75, 0.2),
    MatchOutcome.MOVING: (0.65, 0.4, 0.95),
    MatchOutcome.UNKNOWN: (0.55, 0.57, 0.62),
    MatchOutcome.OUTSIDE: (0.0, 0.0, 0.0),
}
"""Display colors 0..1, in the order of the legend."""

# Covisibility: deterministic ranking of neighboring views by the share of sampled points that both show

_GRID = (24, 16)  # columns and rows of the points sampled per image
_LOOKUP_PX = 96  # width of the coarse depth maps in which points are looked up
_AGREES = 0.1  # relative difference allowed between a point's depth and the coarse depth around it
_MIN_SHARE, _MIN_SURFACES = 0.05, 0.02
"""Minimum shares of the image, and of the image below the sky, that neighbors have in common: all skies are alike. The
cameras of rigs share 0.06 to 0.2."""
_SAME_PLACE, _MIN_ALIKE = 1e-6, 0.6
"""Largest pose difference of a camera at rest, and smallest edge correlation of two images of the same scene at equal
poses: a camera at rest in rain has 0.9, one drive a second later 0.5, unrelated streets 0.1."""
_EDGES_PX = (48, 32)
_MEASURED_SHARE = 0.25
_FAR_M = 1e4


@dataclass(frozen=True, slots=True, eq=False)
class _CoarseView:
    """Summary of a view, to compare it with all others."""

    camera: Camera
    sensor: str
    time_s: float
    points: Float64[np.ndarray, "n 3"]
    """World frame; the sky very far away."""
    distances: Values
    """Depth of the points along the view axis."""
    tried: int
    """Number of sampled pixels, with or without depth."""
    depth: Plane
    """Coarse depth; the sky very far away, 0 if unknown."""
    edges: Float32[np.ndarray, " k"]
    has_pose: bool


def rank_neighbors(views: Sequence[ClearView], count: int) -> list[tuple[int, ...]]:
    """Return for each view up to `count` neighbors: the other views that show most of its image, best first.

    Views without pose or depth have no neighbors, and views that share little but the sky are not neighbors. Neighbors
    in time usually rank first. If `count` is 2 or more and all best views are from the same camera, the last place goes
    to the best view of another camera, so that a rig's cameras are linked. Each view is read once, in order. Ties go to
    the nearer view in time, then to the earlier one.
    """
    coarse = [_coarse_view(view) for view in views]
    chosen: list[tuple[int, ...]] = []
    for i, own in enumerate(coarse):
        shares = [_share(own, other) if i != j else 0.0 for j, other in enumerate(coarse)]
        ranked = sorted(
            (j for j, share in enumerate(shares) if share > 0),
            key=lambda j: (-round(shares[j], 3), abs(coarse[j].time_s - own.time_s), j),
        )
        best = ranked[:count]
        across = [j for j in ranked if coarse[j].sensor != own.sensor]
        if count >= 2 and across and not set(across) & set(best):
            best = [*best[: count - 1], across[0]]
        chosen.append(tuple(best))
    return chosen


def _coarse_view(view: ClearView) -> _CoarseView:
    camera = view.camera
    known = np.isfinite(view.depth) & (view.depth > 0)
    depth = np.where(view.sky > 0.5, _FAR_M, np.where(known, view.depth, 0)).astype(np.float32)
    v, u = _sample_pixels(depth)
    z = depth[v, u].astype(np.float64)
    local = np.stack([(u + 0.5 - camera.cx) / camera.fx * z, (v + 0.5 - camera.cy) / camera.fy * z, z], axis=1)
    points = (local - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3]
    every = max(camera.width // _LOOKUP_PX, 1)
    small = np.ascontiguousarray(depth[every // 2 :: every, every // 2 :: every])
    edges = _edges(view.image)
    return _CoarseView(camera, view.sensor, view.time_s, points[z > 0], z[z > 0], len(z), small, edges, view.has_pose)


def _edges(image: Image) -> Float32[np.ndarray, " k"]:
    """Edges of the downscaled image, of mean 0 and norm 1; all 0 if it has none."""
    small = cv2.resize(image.mean(axis=2), _EDGES_PX, interpolation=cv2.INTER_AREA)
    edges = np.asarray(cv2.Laplacian(small, cv2.CV_32F)).ravel()
    edges = edges - edges.mean()
    return (edges / max(float(np.linalg.norm(edges)), 1e-6)).astype(np.float32)


def _sample_pixels(depth: Plane) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """Rows and columns of a regular grid; if lidar covers little of it, of evenly chosen measured pixels."""
    rows, columns = (
        ((np.arange(n) + 0.5) * size / n).astype(np.int64) for n, size in zip(_GRID[::-1], depth.shape, strict=True)
    )
    v, u = (each.ravel() for each in np.meshgrid(rows, columns, indexing="ij"))
    if np.count_nonzero(depth[v, u]) >= _MEASURED_SHARE * len(v):
        return v, u
    measured = np.flatnonzero(depth)
    evenly = measured[np.linspace(0, len(measured) - 1, min(len(v), len(measured))).astype(np.int64)]
    return evenly // depth.shape[1], evenly % depth.shape[1]


def _share(of: _CoarseView, to: _CoarseView) -> float:
    """Share of a view's image that another one shows too; 0 if it is unknown or negligible.

    Points that the other view shows at another scale are weighted by the scale ratio.
    """
    if not (of.has_pose and to.has_pose and of.depth.any() and to.depth.any()):
        return 0.0
    camera = to.camera
    moved = np.abs(of.camera.world_to_camera - camera.world_to_camera).max()
    if moved <= _SAME_PLACE and float(of.edges @ to.edges) < _MIN_ALIKE:
        return 0.0  # both poses are placeholders
    x, y, z = camera.world_to_camera[:3, :3] @ of.points.T + camera.world_to_camera[:3, 3:]
    ahead = z > 1e-6
    divisor = np.where(ahead, z, 1.0)
    u = (camera.fx * x / divisor + camera.cx) / camera.width
    v = (camera.fy * y / divisor + camera.cy) / camera.height
    inside = ahead & (u >= 0) & (u < 1) & (v >= 0) & (v < 1)
    visible = _is_unoccluded(to.depth, u[inside], v[inside], z[inside])
    distances = of.distances[inside][visible]
    larger = (camera.fx / z[inside][visible]) / (of.camera.fx / distances)
    each = np.minimum(larger, 1 / larger) / max(of.tried, 1)
    share, surfaces = float(each.sum()), float(each[distances <= 0.5 * _FAR_M].sum())
    return share if share >= _MIN_SHARE and surfaces >= _MIN_SURFACES else 0.0


def _is_unoccluded(depth: Plane, u: Values, v: Values, z: Values) -> Bool[np.ndarray, " n"]:
    """Mask of points that match the coarse depth at `u`, `v` (shares of the image); unknown depth hides nothing."""
    found = depth[(v * depth.shape[0]).astype(int), (u * depth.shape[1]).astype(int)]
    agrees = np.where(z > 0.5 * _FAR_M, found > 0.5 * _FAR_M, np.abs(found - z) <= _AGREES * z)
    return agrees | (found == 0)
