"""Water on the ground: a map of films and standing water, with heights if known, and the share of them on Gaussians."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64, UInt8

from ..kernels import kernel
from .gaussians import SH_C0, Gaussians, IdentityKey, scene_cache, sh_basis

FILM_SLOPE, STANDING_SLOPE = 0.10, 0.02
"""Standard deviation of the slope of a film over asphalt, and of standing water in rain."""
UPON_M = 0.03
"""Gaussians of any shape up to this height over the ground belong to it."""
THICKNESS_M = 0.20
"""Flat, level Gaussians up to this height over the ground belong to it: sidewalks are higher than the road."""
_LEVEL = 0.9  # minimum upward component of a level Gaussian's normal
_FLAT = 0.5  # largest ratio of a flat Gaussian's shortest axis to its middle one


@dataclass(frozen=True, slots=True, eq=False)
class GroundWater:
    """Map of the water that the ground of a scene holds when fully wet. World frame, meters."""

    corner_m: tuple[float, float]
    """Corner of the first cell, with the smallest x and y."""
    cell_m: float
    cover: UInt8[np.ndarray, "rows columns 2"]
    """Shares of the ground, in 1/255, that a film and standing water cover; rows along y. None outside."""
    heights_m: Float32[np.ndarray, "rows columns"] | None = None
    """Height of the ground at the middle of each cell; None if it is level, at the height that the scene states."""
    scatter_m: float = 0.0
    """Standard deviation of the distance of a capture's Gaussians from its ground."""

    def at(self, points: Float[np.ndarray, "n 2"]) -> Float32[np.ndarray, "n 2"]:
        """Shares of film and standing water, 0..1, at points of the ground (x and y in the world)."""
        shares = np.empty((len(points), 2), np.float32)
        x, y = self.corner_m
        _look_up(
            np.ascontiguousarray(points), np.float32(x), np.float32(y), np.float32(self.cell_m), self.cover, shares
        )
        return shares

    def cells(
        self, points: Float[np.ndarray, "n 2"]
    ) -> tuple[Bool[np.ndarray, " n"], Int64[np.ndarray, " m"], Int64[np.ndarray, " m"]]:
        """Mask of points inside the map, and the rows and columns of their cells."""
        rows, columns = self.cover.shape[:2]
        cells = np.floor((points - np.array(self.corner_m, np.float32)) / np.float32(self.cell_m))
        inside = np.all((cells >= 0) & (cells < (columns, rows)), axis=1)  # false for NaN, too
        column, row = cells[inside].astype(np.int64).T
        return inside, row, column

    def height_at(self, points: Float[np.ndarray, "n 2"]) -> Float32[np.ndarray, " n"]:
        """Height of the ground at points, linear between cells, that of the nearest cell outside; of uneven ground."""
        assert self.heights_m is not None
        rows, columns = self.heights_m.shape
        x, y = ((points - np.array(self.corner_m)) / self.cell_m - 0.5).astype(np.float32).T
        x, y = np.clip(np.nan_to_num(x), 0, columns - 1), np.clip(np.nan_to_num(y), 0, rows - 1)
        left = np.minimum(x.astype(np.int64), max(columns - 2, 0))
        low = np.minimum(y.astype(np.int64), max(rows - 2, 0))
        u, v, right, high = x - left, y - low, np.minimum(left + 1, columns - 1), np.minimum(low + 1, rows - 1)
        h = self.heights_m
        nearer, farther = (1 - u) * h[low, left] + u * h[low, right], (1 - u) * h[high, left] + u * h[high, right]
        return ((1 - v) * nearer + v * farther).astype(np.float32)

    def moved(self, x_m: float, y_m: float, z_m: float) -> "GroundWater":
        heights = None if self.heights_m is None else self.heights_m + np.float32(z_m)
        return replace(self, corner_m=(self.corner_m[0] + x_m, self.corner_m[1] + y_m), heights_m=heights)

    def scaled(self, factor: float) -> "GroundWater":
        """Map of a world that is larger by a factor."""
        (x, y), heights = self.corner_m, self.heights_m
        return replace(
            self, corner_m=(x * factor, y * factor), cell_m=self.cell_m * factor, scatter_m=self.scatter_m * factor,
            heights_m=None if heights is None else heights * np.float32(factor),
        )  # fmt: skip


@kernel(error_model="numpy")
@no_type_check
def _look_up(points, corner_x, corner_y, cell, cover, shares):
    """As `GroundWater.cells` finds them, one by one."""
    rows, columns = cover.shape[:2]
    for n in range(len(points)):
        column, row = np.floor((points[n, 0] - corner_x) / cell), np.floor((points[n, 1] - corner_y) / cell)
        if column >= 0 and column < columns and row >= 0 and row < rows:
            for water in range(2):
                shares[n, water] = np.float32(cover[int(row), int(column), water]) * np.float32(1 / 255)
        else:
            shares[n, 0] = shares[n, 1] = 0


@dataclass(frozen=True, slots=True, eq=False)
class GroundMembership:
    """Gaussians of one item that are ground, or water on it."""

    film: Float32[np.ndarray, "n 2"] | None
    """Shares of film and standing water when fully wet; None if no Gaussian holds any."""
    is_low: Bool[np.ndarray, " n"]
    """Gaussians that lie on or under the ground, or hold water: a mirror of the ground does not reflect them."""


def ground_membership(
    gaussians: Gaussians,
    to_world: Float64[np.ndarray, "4 4"],
    ground_m: float,
    water: GroundWater,
    *,
    is_fixed: bool = True,
) -> GroundMembership:
    """Find the Gaussians that are ground, at a height (m) or at those of the map; the last results are cached.

    The ground of a capture scatters: there, Gaussians up to 1.5 standard deviations higher belong to it, and flat ones
    up to 2, if they are fixed, unlike those of actors.
    """
    return _membership(gaussians, to_world.tobytes(), ground_m, IdentityKey(water), is_fixed)


@scene_cache(maxsize=64)
def _membership(
    gaussians: Gaussians, to_world: bytes, ground_m: float, key: IdentityKey, is_fixed: bool
) -> GroundMembership:
    water: GroundWater = key.of  # pyright: ignore[reportAssignmentType]
    pose = np.frombuffer(to_world, np.float64).reshape(4, 4).astype(np.float32)
    means, scatter = gaussians.means, water.scatter_m if is_fixed else 0.0
    upon, thickness = UPON_M + 1.5 * scatter, THICKNESS_M + 2 * scatter
    if water.heights_m is None:
        over = means @ pose[2, :3] + (pose[2, 3] - np.float32(ground_m))
    else:
        over = means @ pose[2, :3] + (pose[2, 3] - water.height_at(means @ pose[:2, :3].T + pose[:2, 3]))
    near = np.flatnonzero(np.abs(over) < thickness)
    is_low = over < upon
    lying = near[(np.abs(over[near]) < upon) | _is_level(gaussians, near, pose)]
    shares = water.at(means[lying] @ pose[:2, :3].T + pose[:2, 3])
    if not np.any(shares):
        return GroundMembership(None, is_low)
    film = np.zeros((len(means), 2), np.float32)
    film[lying] = shares
    is_low[lying] |= shares.any(axis=1)
    return GroundMembership(film, is_low)


def _is_level(
    gaussians: Gaussians, rows: Int64[np.ndarray, " m"], pose: Float32[np.ndarray, "4 4"]
) -> Bool[np.ndarray, " m"]:
    """Mask of flat Gaussians whose shortest axis is upright in the world."""
    scales, (w, x, y, z) = gaussians.scales[rows], gaussians.quaternions[rows].T
    axes = np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1),
            np.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)], axis=1),
            np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1),
        ],
        axis=1,
    )
    shortest = np.argmin(scales, axis=1)
    normals = np.take_along_axis(axes, shortest[:, None, None], axis=1)[:, 0]
    upward = np.abs(normals @ pose[2, :3]) / max(float(np.linalg.norm(pose[2, :3])), 1e-12)
    ordered = np.sort(scales, axis=1)
    return (upward > _LEVEL) & (ordered[:, 0] < _FLAT * ordered[:, 1])


@dataclass(frozen=True, slots=True, eq=False)
class WetGround:
    """Ground of a scene where it may be wet, with its heights over the cells of a map of water. World frame, meters."""

    ground_m: float
    """Height outside of the map."""
    water: GroundWater | None = None
    heights_m: Float32[np.ndarray, "rows columns"] | None = None
    """Highest level Gaussian that belongs to the ground, in cells without any that of the nearest cell."""

    def at(self, points: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        """Height of the ground at points (x and y in the world)."""
        heights = np.full(len(points), self.ground_m)
        if self.water is not None and self.heights_m is not None:
            inside, row, column = self.water.cells(points)
            heights[inside] = self.heights_m[row, column]
        return heights

    def is_open(self, points: Float64[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Mask of points where the map has water; all of them without a map."""
        if self.water is None:
            return np.ones(len(points), np.bool_)
        return np.asarray(self.water.at(points).any(axis=1))


def ground_heights(
    items: Sequence[tuple[Gaussians, Float64[np.ndarray, "4 4"]]], ground_m: float, water: GroundWater | None
) -> WetGround:
    """Heights of the ground by the Gaussians (with their poses) that hold water; the last results are cached."""
    if water is None:
        return WetGround(ground_m)
    if water.heights_m is not None:
        return WetGround(ground_m, water, water.heights_m)
    sets, poses = (tuple(IdentityKey(g) for g, _ in items), tuple(pose.tobytes() for _, pose in items))
    return _heights(sets, poses, ground_m, IdentityKey(water))


@scene_cache(maxsize=4)
def _heights(sets: tuple[IdentityKey, ...], poses: tuple[bytes, ...], ground_m: float, key: IdentityKey) -> WetGround:
    water: GroundWater = key.of  # pyright: ignore[reportAssignmentType]
    heights = np.full(water.cover.shape[:2], -np.inf, np.float32)
    for each, pose in zip(sets, poses, strict=True):
        gaussians: Gaussians = each.of  # pyright: ignore[reportAssignmentType]
        to_world = np.frombuffer(pose, np.float64).reshape(4, 4)
        film = ground_membership(gaussians, to_world, ground_m, water).film
        if film is None:
            continue
        own = np.flatnonzero(film.any(axis=1))
        means = gaussians.means[own] @ to_world[:3, :3].T + to_world[:3, 3]
        inside, row, column = water.cells(means[:, :2])
        np.maximum.at(heights, (row, column), means[inside, 2].astype(np.float32))
    is_empty = ~np.isfinite(heights)
    if is_empty.all():
        return WetGround(ground_m, water)
    from scipy import ndimage  # takes long to load

    nearest: Any = ndimage.distance_transform_edt(is_empty, return_distances=False, return_indices=True)
    return WetGround(ground_m, water, heights[nearest[0], nearest[1]])


_GRAZING = 0.35  # sine of the viewing angle to the ground that stands for a capture's cameras


def matte_wet_sh(
    wet_sh: Float32[np.ndarray, "n k 3"],
    film: Float32[np.ndarray, "n 2"],
    to_world: Float64[np.ndarray, "4 4"],
    *,
    of_capture: bool = False,
) -> Float32[np.ndarray, "n k 3"]:
    """Wet colors without reflections where there is water: the color that is visible from straight above.

    Water reflects 2 % there, so that what remains is the light that the ground itself scatters. Cameras of a capture
    have not been there: its color is the mean over all azimuths of what they see. Cached, as above.
    """
    downward = -np.ascontiguousarray(to_world[2, :3], np.float64)
    return _matte(IdentityKey(wet_sh), IdentityKey(film), downward.tobytes(), of_capture)


@scene_cache(maxsize=64)
def _matte(wet: IdentityKey, film: IdentityKey, downward: bytes, of_capture: bool) -> Float32[np.ndarray, "n k 3"]:
    sh: np.ndarray = wet.of  # pyright: ignore[reportAssignmentType]
    shares: np.ndarray = film.of  # pyright: ignore[reportAssignmentType]
    direction = np.frombuffer(downward, np.float64)
    directions = (direction / np.linalg.norm(direction))[None]
    if of_capture:
        across = np.cross(directions[0], np.eye(3)[np.argmin(np.abs(directions[0]))])
        across /= np.linalg.norm(across)
        turns = 2 * np.pi * np.arange(8)[:, None] / 8
        level = np.cos(turns) * across + np.sin(turns) * np.cross(directions[0], across)
        directions = _GRAZING * directions + np.sqrt(1 - _GRAZING**2) * level
    basis = sh_basis(directions, sh.shape[1]).mean(axis=0).astype(np.float32)
    wet_rows = shares.any(axis=1)
    matte = sh.copy()
    matte[wet_rows] = 0
    color = np.einsum("k,nkc->nc", basis, sh[wet_rows])
    matte[wet_rows, 0] = np.maximum(color, np.float32(-0.5)) / np.float32(SH_C0)
    return matte
