"""Covisibility: deterministic ranking of neighboring views by the share of sampled points that both show."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from ..scene.camera import Camera
from .base import ClearView

_GRID = (24, 16)  # columns and rows of the points sampled per image
_LOOKUP_PX = 96  # width of the coarse depth maps in which points are looked up
_AGREES = 0.1  # relative difference allowed between a point's depth and the coarse depth around it
_MIN_SHARE, _MIN_SURFACES = 0.05, 0.02
"""Least shares of the image, and of the image below the sky, that neighbors have in common: all skies are alike. The
cameras of rigs share 0.06 to 0.2."""

_SAME_PLACE, _MIN_ALIKE = 1e-6, 0.6
"""Largest pose difference of a camera at rest, and least edge correlation of two images of the same scene at equal
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
    distances: Float64[np.ndarray, " n"]
    """Depth of the points along the view axis."""
    tried: int
    """Number of sampled pixels, with or without depth."""
    depth: Float32[np.ndarray, "h w"]
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
    sketches = [_sketched(view) for view in views]
    chosen: list[tuple[int, ...]] = []
    for i, sketch in enumerate(sketches):
        shares = [_share(sketch, other) if i != j else 0.0 for j, other in enumerate(sketches)]
        ranked = sorted(
            (j for j, share in enumerate(shares) if share > 0),
            key=lambda j: (-round(shares[j], 3), abs(sketches[j].time_s - sketch.time_s), j),
        )
        best = ranked[:count]
        across = [j for j in ranked if sketches[j].sensor != sketch.sensor]
        if count >= 2 and across and not set(across) & set(best):
            best = [*best[: count - 1], across[0]]
        chosen.append(tuple(best))
    return chosen


def _sketched(view: ClearView) -> _CoarseView:
    camera = view.camera
    depth = _far_sky(view)
    v, u = _places_tried(depth)
    z = depth[v, u].astype(np.float64)
    local = np.stack([(u + 0.5 - camera.cx) / camera.fx * z, (v + 0.5 - camera.cy) / camera.fy * z, z], axis=1)
    points = (local - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3]
    every = max(camera.width // _LOOKUP_PX, 1)
    small = np.ascontiguousarray(depth[every // 2 :: every, every // 2 :: every])
    edges = _edges(view.image)
    return _CoarseView(camera, view.sensor, view.time_s, points[z > 0], z[z > 0], len(z), small, edges, view.has_pose)


def _edges(image: Float32[np.ndarray, "h w 3"]) -> Float32[np.ndarray, " k"]:
    """Edges of the downscaled image, of mean 0 and norm 1; all 0 if it has none."""
    small = cv2.resize(image.mean(axis=2), _EDGES_PX, interpolation=cv2.INTER_AREA)
    edges = np.asarray(cv2.Laplacian(small, cv2.CV_32F)).ravel()
    edges = edges - edges.mean()
    return (edges / max(float(np.linalg.norm(edges)), 1e-6)).astype(np.float32)


def _places_tried(depth: Float32[np.ndarray, "h w"]) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
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


def _far_sky(view: ClearView) -> Float32[np.ndarray, "h w"]:
    known = np.isfinite(view.depth) & (view.depth > 0)
    return np.where(view.sky > 0.5, _FAR_M, np.where(known, view.depth, 0)).astype(np.float32)


def _share(of: _CoarseView, to: _CoarseView) -> float:
    """Share of a view's image that another one shows too; 0 if it is unknown or negligible."""
    if not (of.has_pose and to.has_pose and of.depth.any() and to.depth.any()):
        return 0.0
    moved = np.abs(of.camera.world_to_camera - to.camera.world_to_camera).max()
    if moved <= _SAME_PLACE and float(of.edges @ to.edges) < _MIN_ALIKE:
        return 0.0  # both poses are placeholders
    share, surfaces = _visible_share(of, to)
    return share if share >= _MIN_SHARE and surfaces >= _MIN_SURFACES else 0.0


def _visible_share(of: _CoarseView, to: _CoarseView) -> tuple[float, float]:
    """Share of a view's image that another one shows too, with and without the sky.

    Points that the other view shows at another scale are weighted by the scale ratio.
    """
    camera = to.camera
    x, y, z = camera.world_to_camera[:3, :3] @ of.points.T + camera.world_to_camera[:3, 3:]
    ahead = z > 1e-6
    divisor = np.where(ahead, z, 1.0)
    u = (camera.fx * x / divisor + camera.cx) / camera.width
    v = (camera.fy * y / divisor + camera.cy) / camera.height
    inside = ahead & (u >= 0) & (u < 1) & (v >= 0) & (v < 1)
    seen = _is_unoccluded(to.depth, u[inside], v[inside], z[inside])
    larger = (camera.fx / z[inside][seen]) / (of.camera.fx / of.distances[inside][seen])
    each = np.minimum(larger, 1 / larger) / max(of.tried, 1)
    return float(each.sum()), float(each[of.distances[inside][seen] <= 0.5 * _FAR_M].sum())


def _is_unoccluded(
    depth: Float32[np.ndarray, "h w"],
    u: Float64[np.ndarray, " n"],
    v: Float64[np.ndarray, " n"],
    z: Float64[np.ndarray, " n"],
) -> Bool[np.ndarray, " n"]:
    """Mask of points that match the coarse depth at `u`, `v` (shares of the image); unknown depth hides nothing."""
    found = depth[(v * depth.shape[0]).astype(int), (u * depth.shape[1]).astype(int)]
    is_sky = z > 0.5 * _FAR_M
    agrees = np.where(is_sky, found > 0.5 * _FAR_M, np.abs(found - z) <= _AGREES * z)
    return agrees | (found == 0)
