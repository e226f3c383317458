"""Ground geometry: the plane of the ground, mirrored cameras, and a height map. World frame (meters, z up)."""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Float32, Float64
from scipy import ndimage

from ...scene.camera import Camera

_STEEPEST_UP = 0.9  # least upward component of the ground's normal: a slope of 26 degrees
_TRIPLES, _VOTERS = 400, 4000
_NEAR_PLANE_M = 0.08  # points this close to a plane vote for it
_BELOW_COUNTS = 2.0
"""Weight of a vote against a plane, by a point below it, relative to a vote for it: nothing is under the ground."""
_ROUNDS = 6


@dataclass(frozen=True, slots=True, eq=False)
class GroundPlane:
    """Plane of all points with normal . point = offset_m."""

    normal: Float64[np.ndarray, "3"]
    """Unit, upwards, in the world."""
    offset_m: float

    def heights(self, points: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
        """Signed distance of points over the plane, in meters."""
        return np.asarray(points, np.float64) @ self.normal - self.offset_m

    @property
    def reflection(self) -> Float64[np.ndarray, "4 4"]:
        """Matrix that maps world points to their mirror images (Householder); its determinant is -1."""
        matrix = np.eye(4)
        matrix[:3, :3] -= 2 * np.outer(self.normal, self.normal)
        matrix[:3, 3] = 2 * self.offset_m * self.normal
        return matrix

    def mirrored(self, camera: Camera) -> Camera:
        """Return the camera at the eye's mirror image, which renders the plane's reflection.

        A reflection makes a right-handed camera left-handed, so the image's rows are flipped: the reflection at (u, v)
        of the eye's image is at (u, height - v) of the mirrored camera's. Mirroring twice gives the original camera.
        """
        pose = np.diag([1.0, -1.0, 1.0, 1.0]) @ camera.world_to_camera @ self.reflection
        return replace(camera, cy=camera.height - camera.cy, world_to_camera=pose)


def fit_ground_plane(points: Float64[np.ndarray, "n 3"], tolerance_m: float) -> GroundPlane | None:
    """Fit the ground plane under points of which most may lie on other objects; None if there is none.

    Candidates are upright planes through three points, chosen by votes (RANSAC, Fischler and Bolles 1981; points far
    below count against a plane). The best one is refined by reweighted least squares (Cauchy's weights of scale
    `tolerance_m`). The random draws are seeded.
    """
    if len(points) < 3:
        return None
    rng = np.random.default_rng(0)
    voters = points[rng.integers(len(points), size=_VOTERS)]
    triples = points[rng.integers(len(points), size=(_TRIPLES, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals / np.maximum(lengths, 1e-12)[:, None]
    normals = normals * np.where(normals[:, 2] < 0, -1.0, 1.0)[:, None]
    upright = (normals[:, 2] > _STEEPEST_UP) & (lengths > 1e-9)
    if not upright.any():
        return None
    normals, offsets = normals[upright], np.einsum("ij,ij->i", normals[upright], triples[upright, 0])
    heights = voters @ normals.T - offsets
    votes = np.sum(np.abs(heights) < _NEAR_PLANE_M, axis=0) - _BELOW_COUNTS * np.sum(heights < -0.3, axis=0)
    best = int(np.argmax(votes))
    return refine_plane(GroundPlane(normals[best], float(offsets[best])), points, tolerance_m)


def refine_plane(plane: GroundPlane, points: Float64[np.ndarray, "n 3"], tolerance_m: float) -> GroundPlane:
    """Fit a plane to the points near it, by reweighted least squares (Cauchy's weights)."""
    for _ in range(_ROUNDS):
        weights = 1 / (1 + (plane.heights(points) / tolerance_m) ** 2) ** 2
        total = weights.sum()
        if total < 3:
            return plane
        middle = weights @ points / total
        about = points - middle
        _, vectors = np.linalg.eigh((about * weights[:, None]).T @ about)
        normal = vectors[:, 0] * (1.0 if vectors[2, 0] >= 0 else -1.0)
        if normal[2] < _STEEPEST_UP:
            return plane
        plane = GroundPlane(normal, float(normal @ middle))
    return plane


# Ground heights: one height map per scene, shared by all views

CELL_M = 0.25
_MAX_CELLS = 1200  # most cells per side; cells grow in larger scenes
_WITHIN = (0.005, 0.995)  # quantiles of the points that bound the map
_MARGIN_M = 4.0
_ABOVE_COUNTS = 0.2
"""Weight of a point over the surface relative to one under it, since many objects are over the ground."""
_MANY = 4
"""Points in a cell above which more points add little: nearby objects have more points but are no likelier ground."""
_PASSES = ((8.0, 1.0, 6), (4.0, 0.5, 4), (2.0, 0.25, 3), (1.0, 0.12, 3), (0.5, 0.08, 2))
"""Smoothing in meters, band in meters, number of iterations: from terrain down to lanes."""
_MIN_BAND = 2.0  # least width of a band, as a multiple of the points' scatter about the ground
_SCATTER_WITHIN_M = 0.5
_ENOUGH = 0.02  # smoothed weight of points per cell at which they move the surface half-way
_SMOOTH_M = 1.2  # scale of the slopes used for reflections; finer ones are mostly noise of the reconstruction
_DIP_M = 1.2  # scale of the mean height from which the depth of a dip is measured
_MAX_DIP_M, _DIP_SHARE = 0.03, 0.12
"""Deepest dip that is accepted, and the share of it that counts: captures are uncertain by as much."""
_RUT_M, _RUT_WIDTH_M, _HALF_TRACK_M = 0.005, 0.25, 0.78
"""Depth and half width of wheel ruts in a lane, and their distance from its center line."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundHeights:
    """Heights over a grid of the world's x and y; beyond the grid, the nearest cell's."""

    corner_m: tuple[float, float]
    """x and y of the center of the first cell."""
    cell_m: float
    fine_m: Float32[np.ndarray, "rows columns"]
    """Height of the ground, rows along y."""
    smooth_m: Float32[np.ndarray, "rows columns"]
    """Height without features smaller than about two meters."""
    sunk_m: Float32[np.ndarray, "rows columns"]
    """Depth of each cell below its surroundings: dips, limited to a plausible depth, and wheel ruts."""
    scatter_m: float
    """Standard deviation of the distance of ground points from the surface."""

    def sampled(
        self, grid: Float32[np.ndarray, "rows columns"], points: Float[np.ndarray, "*n 3"]
    ) -> Float32[np.ndarray, "*n"]:
        """Values of one of the grids under each point, interpolated between cells."""
        x, y = (((points[..., k] - self.corner_m[k]) / self.cell_m).astype(np.float32) for k in (0, 1))
        flat = x.reshape(1, -1), y.reshape(1, -1)
        pieces = [
            cv2.remap(grid, flat[0][:, k : k + 32000], flat[1][:, k : k + 32000], cv2.INTER_LINEAR,
                      borderMode=cv2.BORDER_REPLICATE)
            for k in range(0, flat[0].size, 32000)
        ]  # fmt: skip
        return np.concatenate(pieces or [np.zeros((1, 0), np.float32)], axis=1).reshape(x.shape)

    def with_ruts(self, path_m: Float64[np.ndarray, "n 2"]) -> "GroundHeights":
        """Return a copy with the ruts of a lane whose center line is `path_m` (x and y)."""
        off_path = np.full(self.fine_m.shape, 255, np.uint8)
        cells = np.rint((path_m - self.corner_m) / self.cell_m * 16).astype(np.int32)  # four fractional bits
        cv2.polylines(off_path, [cells.reshape(-1, 1, 2)], False, 0, 1, cv2.LINE_8, 4)
        distance: Any = ndimage.distance_transform_edt(off_path)
        ruts = _RUT_M * np.exp(-0.5 * ((distance * self.cell_m - _HALF_TRACK_M) / _RUT_WIDTH_M) ** 2)
        return replace(self, sunk_m=(self.sunk_m + ruts).astype(np.float32))

    def normals(self, points: Float[np.ndarray, "*n 3"]) -> Float32[np.ndarray, "*n 3"]:
        """Unit upward normals of the smooth ground under points."""
        down_y, down_x = np.gradient(-self.smooth_m, self.cell_m)
        slopes = np.stack([self.sampled(down_x, points), self.sampled(down_y, points)], axis=-1)
        length = np.sqrt(1 + np.sum(slopes * slopes, axis=-1, keepdims=True))
        return np.concatenate([slopes, np.ones_like(length)], axis=-1) / length


def ground_heights(points: Float64[np.ndarray, "n 3"], start: GroundPlane) -> GroundHeights:
    """Find the ground among points on all objects, starting from an approximate plane.

    The surface repeatedly moves to the smoothed mean of the points in a band around it, while band and smoothing
    shrink, so it follows slopes and a road's crown, and passes under cars and bushes. Cells without points keep the
    result of the next larger scale.
    """
    low, high = np.quantile(points[:, :2], _WITHIN, axis=0)
    low, high = low - _MARGIN_M, high + _MARGIN_M
    cell = max(CELL_M, float((high - low).max()) / _MAX_CELLS)
    columns, rows = (np.ceil((high - low) / cell).astype(int) + 1).tolist()
    place = np.rint((points[:, :2] - low) / cell).astype(np.int64)
    inside = ((place >= 0) & (place < [columns, rows])).all(axis=1)
    cells, z = place[inside, 1] * columns + place[inside, 0], points[inside, 2]
    y, x = np.mgrid[:rows, :columns]
    height = (start.offset_m - (low[0] + cell * x) * start.normal[0] - (low[1] + cell * y) * start.normal[1]).ravel()
    height = height / start.normal[2]
    each_counts = (1 / (1 + np.bincount(cells, minlength=rows * columns) / _MANY))[cells]
    scatter = 0.0
    for scale_m, band_m, times in _PASSES:
        band = min(max(band_m, _MIN_BAND * scatter), 1.0)
        for _ in range(times):
            above = z - height[cells]
            weights = each_counts * np.exp(-0.5 * (above / band) ** 2) * np.where(above > 0.5 * band, _ABOVE_COUNTS, 1)
            sums = (np.bincount(cells, each, rows * columns) for each in (weights * above, weights))
            moved, weight = (_smoothed(each.reshape(rows, columns), scale_m / cell) for each in sums)
            height = height + (moved / (weight + _ENOUGH * min(1.0, band))).ravel()
        above = z - height[cells]
        near = above[np.abs(above) < _SCATTER_WITHIN_M]
        scatter = 1.4826 * float(np.median(np.abs(near - np.median(near)))) if len(near) else 0.0
    fine = height.reshape(rows, columns)
    sunk = _DIP_SHARE * np.clip(_smoothed(fine, _DIP_M / cell) - fine, -_MAX_DIP_M, _MAX_DIP_M)
    fine, smooth, sunk = (each.astype(np.float32) for each in (fine, _smoothed(fine, _SMOOTH_M / cell), sunk))
    return GroundHeights((float(low[0]), float(low[1])), cell, fine, smooth, sunk, scatter)


def _smoothed(grid: Float64[np.ndarray, "rows columns"], sigma: float) -> Float64[np.ndarray, "rows columns"]:
    return ndimage.gaussian_filter(grid, sigma, mode="nearest", truncate=2.5)
