"""Surfels: disc-shaped Gaussians along the surfaces of a view, with point colors and camera trajectories."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64
from scipy.spatial import KDTree

from ..datasets.capture import CaptureFrame
from ..datasets.masks import pixel_rays
from ..scene.camera import Camera
from ..scene.gaussians import Gaussians, sh_from_color
from ..scene.geometry import matrices_from_quaternions, quaternions_from_matrices

Depths = Sequence[Float32[np.ndarray, "_ _"]]
SPREAD = 0.6  # standard deviation of a disc over the spacing of discs: they overlap without much blur
_THICKNESS = 0.1  # standard deviation across the surface over the smaller one along it
_STEEPEST = 16.0  # largest aspect ratio of a disc: surfaces at grazing angles are imprecise
_SLIGHT, _STEEP, _STRAIGHT = 0.05, 0.5, 0.3
"""Relative depth change per pixel. Below the first value it is no edge; up to the second, as on distant road, it is no
edge if the changes before and after differ by at most the third, as a share."""


@dataclass(frozen=True, slots=True, eq=False)
class Surfels:
    """Discs on surfaces, in the world of the capture."""

    means: Float32[np.ndarray, "n 3"]
    axes: Float32[np.ndarray, "n 2 3"]
    """Steps to the next disc along the surface, horizontally and vertically in the image."""
    colors: Float32[np.ndarray, "n 3"]
    """Display colors, 0..1."""

    def __len__(self) -> int:
        return len(self.means)

    @classmethod
    def joined(cls, parts: "list[Surfels]") -> "Surfels":
        return cls(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("means", "axes", "colors")))

    def gaussians(self, opacity: float) -> Gaussians:
        """Return disc-shaped Gaussians whose sigma is `SPREAD` of a step, thin across the surface."""
        first, second = self.axes[:, 0], self.axes[:, 1]
        covariances = np.einsum("ni,nj->nij", first, first) + np.einsum("ni,nj->nij", second, second)
        squares, vectors = np.linalg.eigh(covariances.astype(np.float64))  # ascending: the normal comes first
        sizes = SPREAD * np.sqrt(np.maximum(squares, 0))
        sizes[:, 2] = np.minimum(sizes[:, 2], _STEEPEST * sizes[:, 1])
        sizes[:, 0] = _THICKNESS * sizes[:, 1]
        vectors[:, :, 0] *= np.sign(np.linalg.det(vectors))[:, None]
        quaternions, opacities = quaternions_from_matrices(vectors), np.full(len(self), opacity, np.float32)
        scales, rotations = sizes.astype(np.float32), quaternions.astype(np.float32)
        return Gaussians(self.means, scales, rotations, opacities, sh_from_color(self.colors))


def view_surfels(
    view: CaptureFrame, depth: Float32[np.ndarray, "h w"], stride: int, cells: Bool[np.ndarray, "rows columns"]
) -> Surfels:
    """Make one disc for each wanted cell of stride x stride pixels with a depth along the view axis, at its center."""
    rows, columns = np.nonzero(cells)
    v = np.minimum(rows * stride + stride // 2, view.camera.height - 1)
    u = np.minimum(columns * stride + stride // 2, view.camera.width - 1)
    there = depth[v, u] > 0
    rows, columns, v, u = rows[there], columns[there], v[there], u[there]
    rays = pixel_rays(view.camera)[v, u]
    z = depth[v, u][:, None]
    across, down = depth_slopes(depth)
    step = np.array([1 / view.camera.fx, 1 / view.camera.fy], np.float32)
    rotation = view.camera.world_to_camera[:3, :3].astype(np.float32)
    # Offset to the next pixel: (z + dz) (ray + dray) - z ray, with the relative slope dz = z * slope.
    first = z * (step[0] * rotation[0] + across[v, u][:, None] * rays)
    second = z * (step[1] * rotation[1] + down[v, u][:, None] * rays)
    eye = view.camera.position.astype(np.float32)
    colors = cell_means(view.image, stride)[rows, columns]
    return Surfels(eye + z * rays, np.stack([first, second], axis=1) * np.float32(stride), colors)


def depth_slopes(depth: Float32[np.ndarray, "h w"]) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Relative depth change per pixel to the neighbor with closer inverse depth; 0 at edges and where unknown."""
    inverse = np.where(depth > 0, 1 / np.maximum(depth, 1e-6), 0)
    found: list[Float32[np.ndarray, "h w"]] = []
    for axis in (1, 0):
        steps = np.diff(inverse, axis=axis)
        nothing = np.full_like(inverse[:, :1] if axis else inverse[:1], np.inf)
        before = np.concatenate([nothing, steps], axis=axis)
        after = np.concatenate([steps, nothing], axis=axis)
        smaller = np.where(np.abs(before) < np.abs(after), before, after)
        change = np.where(depth > 0, smaller * depth, 0)
        with np.errstate(invalid="ignore"):
            bend = np.abs(before - after) / np.maximum(np.maximum(np.abs(before), np.abs(after)), 1e-12)
        is_surface = (np.abs(change) < _SLIGHT) | ((bend < _STRAIGHT) & (np.abs(change) < _STEEP))
        found.append(np.where(is_surface, -change, 0).astype(np.float32))
    return found[0], found[1]


def cell_means(pixels: np.ndarray, stride: int) -> Float32[np.ndarray, "rows columns c"]:
    """Mean of the pixels of each cell; 8-bit colors as 0..1."""
    height, width = pixels.shape[:2]
    rows, columns = np.arange(0, height, stride), np.arange(0, width, stride)
    sums = np.asarray(np.add.reduceat(np.add.reduceat(pixels.astype(np.float32), rows, axis=0), columns, axis=1))
    tall = np.asarray(np.diff(np.append(rows, height)), np.float32)
    wide = np.asarray(np.diff(np.append(columns, width)), np.float32)
    scale = 255.0 if pixels.dtype == np.uint8 else 1.0
    return np.asarray(sums / (tall[:, None, None] * wide[None, :, None] * scale), np.float32)


# Splitting of long Gaussians

LONGEST = 0.1
"""Largest standard deviation over the distance to the nearest camera. Renderers linearize perspective around a
Gaussian's center (Zwicker et al. 2001, section 6.2): a road Gaussian that extends past a camera would smear the sky."""


def split_long_gaussians(gaussians: Gaussians, trajectory: Float64[np.ndarray, "p 3"], max_count: int) -> Gaussians:
    """Split Gaussians that are elongated relative to their camera distance into a row of shorter ones.

    `trajectory` has current and possible camera positions. Beyond `max_count` Gaussians the remaining ones are
    shortened without a split.
    """
    longest = gaussians.scales.argmax(axis=1)
    rows = np.arange(len(gaussians))
    sigma = gaussians.scales[rows, longest]
    limit = np.maximum(LONGEST * KDTree(trajectory).query(gaussians.means)[0], 1e-6)
    pieces = np.maximum(np.ceil(sigma / limit), 1).astype(np.int64)
    order = np.argsort(pieces, kind="stable")
    fits = np.cumsum(pieces[order] - 1) <= max_count - len(gaussians)
    pieces[order[~fits]] = 1
    source = np.repeat(rows, pieces)
    first = np.cumsum(pieces) - pieces
    number = np.arange(len(source)) - first[source]
    short = np.minimum(sigma / pieces, limit)
    axes = matrices_from_quaternions(gaussians.quaternions.astype(np.float64))[rows, :, longest]
    along = (number - (pieces[source] - 1) / 2) * short[source] / SPREAD
    scales = gaussians.scales[source].copy()
    scales[np.arange(len(source)), longest[source]] = short[source]
    cut = gaussians.take(source)
    means = gaussians.means[source] + along[:, None] * axes[source]
    return Gaussians(means.astype(np.float32), scales, cut.quaternions, cut.opacities, cut.sh)


# Camera trajectory

_PARTS = 8  # parts per segment between two images
_LONGEST = 0.5  # longest interpolated segment over the typical depth: within it the cameras observe free space


def camera_trajectory(views: Sequence[CaptureFrame], typical_depth: float) -> Float64[np.ndarray, "p 3"]:
    """Camera positions, interpolated between consecutive images of a sensor that are near for the typical depth."""
    places = [view.camera.position for view in views]
    for sensor in dict.fromkeys(view.sensor for view in views):
        own = sorted((view for view in views if view.sensor == sensor), key=lambda view: view.time_s)
        for start, end in pairwise(view.camera.position for view in own):
            if 0 < float(np.linalg.norm(end - start)) <= _LONGEST * typical_depth:
                places += [start + (end - start) * part / _PARTS for part in range(1, _PARTS)]
    return np.array(places)


# Point colors

_NEAR = 0.05
_HIDDEN = 1.06  # A point farther than the surface in its pixel by this factor is occluded
_SLACK = 0.15  # added tolerance in the world's unit, for points on thin objects and edges


def projected(
    points: Float[np.ndarray, "p 3"], camera: Camera
) -> tuple[Int64[np.ndarray, " m"], Int64[np.ndarray, " m"], Int64[np.ndarray, " m"], Float64[np.ndarray, " m"]]:
    """Index, row, column and depth of each point that projects into the image."""
    local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    ahead = np.flatnonzero(local[:, 2] > _NEAR)
    z = local[ahead, 2]
    column = np.floor(local[ahead, 0] / z * camera.fx + camera.cx)
    row = np.floor(local[ahead, 1] / z * camera.fy + camera.cy)
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    return ahead[inside], row[inside].astype(np.int64), column[inside].astype(np.int64), z[inside].astype(np.float64)


def point_colors(
    points: Float[np.ndarray, "p 3"], views: Sequence[CaptureFrame], depths: Depths, max_views: int = 8
) -> tuple[Float32[np.ndarray, "p 3"], Bool[np.ndarray, " p"]]:
    """Median display color of each point over its nearest views, and a mask of visible points (others are gray).

    Points are in the world of the capture, views undistorted; pixels outside their masks are ignored. `depths` are
    those of the surface in each pixel, for occlusion; 0 occludes nothing.
    """
    nearest = np.full((len(points), max_views), np.inf)
    samples = np.full((len(points), max_views, 3), np.nan, np.float32)
    for view, depth in zip(views, depths, strict=True):
        index, row, column, z = projected(points, view.camera)
        surface = depth[row, column]
        visible = (surface <= 0) | (z <= surface * _HIDDEN + _SLACK)
        if view.mask is not None:
            visible &= view.mask[row, column]
        index, row, column, z = index[visible], row[visible], column[visible], z[visible]
        slot = nearest[index].argmax(axis=1)
        nearer = z < nearest[index, slot]
        index, slot = index[nearer], slot[nearer]
        nearest[index, slot] = z[nearer]
        samples[index, slot] = view.image[row[nearer], column[nearer]].astype(np.float32) / 255
    known = np.asarray(np.isfinite(nearest).any(axis=1))
    colors = np.full((len(points), 3), 0.5, np.float32)
    colors[known] = np.nanmedian(samples[known], axis=1)
    return colors, known
