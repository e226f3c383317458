"""Shadows of lamps: a coarse grid of the opacity of a scene, and the share of light that rays through it keep."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, exp, sqrt
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Float32, Float64
from scipy import ndimage

from gsrain_engine.kernels import kernel, range_of

_MAX_CELLS = 3_000_000
_WITHIN = (0.004, 0.996)  # quantiles of the places that bound the grid, along each axis
_BLUR = 0.7  # standard deviation in cells: Gaussians are as large as cells or larger
_ORIENTATION = 0.5  # mean projected area of a disk over all directions, relative to its own
_OWN_CELLS = 2.5
"""Part of a ray before its end that is left out, in cells: a surface does not shade itself."""
_LAMP_M, _LAMP_CELLS = 0.5, 2.0
"""Part of a ray at a lamp that is left out, in meters and in cells at least: the body of the lamp."""


@dataclass(frozen=True, slots=True, eq=False)
class OpacityGrid:
    """Extinction of surfaces in cubic cells. World frame, meters."""

    corner_m: Float64[np.ndarray, "3"]
    """Center of the first cell."""
    cell_m: float
    per_m: Float32[np.ndarray, "x y z"]

    @classmethod
    def of(
        cls, points: Float[np.ndarray, "n 3"], areas_m2: Float[np.ndarray, " n"], widths_m: Float[np.ndarray, " n"]
    ) -> "OpacityGrid":
        """Grid of disks at points, by their areas times opacities; cells are no smaller than two typical widths."""
        if not len(points):
            return cls(np.zeros(3), 1.0, np.zeros((1, 1, 1), np.float32))
        low, high = np.quantile(points.astype(np.float64), _WITHIN, axis=0)
        size = np.maximum(high - low, 1e-3)
        cell = max(float(np.cbrt(size.prod() / _MAX_CELLS)), 2 * float(np.median(widths_m)), float(size.max()) / 1000)
        corner = low - 2 * cell
        shape = np.ceil((high - corner) / cell).astype(np.int64) + 3
        place = np.rint((points - corner) / cell).astype(np.int64)
        inside = ((place >= 0) & (place < shape)).all(axis=1)
        flat = np.ravel_multi_index(tuple(place[inside].T), tuple(shape.tolist()))
        area = np.bincount(flat, areas_m2[inside].astype(np.float64), int(shape.prod())).reshape(tuple(shape.tolist()))
        density = ndimage.gaussian_filter(_ORIENTATION * area / cell**3, _BLUR, truncate=3.0, mode="constant")
        return cls(corner, cell, density.astype(np.float32))

    def transmittance(
        self, lamp_m: Float64[np.ndarray, "3"], points: Float[np.ndarray, "n 3"]
    ) -> Float32[np.ndarray, " n"]:
        """Share of a lamp's light that surfaces on its rays to points leave, 0..1."""
        left = np.empty(len(points), np.float32)
        _toward(self.per_m, self.corner_m, self.cell_m, lamp_m, points.astype(np.float64), left)
        return left

    def openness(
        self, points: Float[np.ndarray, "n 3"], directions: Sequence[Sequence[float]]
    ) -> Float32[np.ndarray, "n d"]:
        """Share of light from unit directions far away that reaches points, 0..1."""
        ways = np.asarray(directions, np.float64)
        left = np.empty((len(points), len(ways)), np.float32)
        _from_afar(self.per_m, self.corner_m, self.cell_m, points.astype(np.float64), ways, left)
        return left

    def sampled(self, points: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, " n"]:
        """Extinction (1/m) at points."""
        places = ((points - self.corner_m) / self.cell_m).T
        return ndimage.map_coordinates(self.per_m, places, order=1, mode="constant").astype(np.float32)


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _toward(portion, per_m, corner, cell, lamp, points, left):
    body = max(_LAMP_M, _LAMP_CELLS * cell)
    for i in range_of(portion, len(points)):
        x, y, z = lamp[0] - points[i, 0], lamp[1] - points[i, 1], lamp[2] - points[i, 2]
        length = sqrt(x * x + y * y + z * z)
        if not length > 0:
            left[i] = 1
            continue
        left[i] = exp(-_depth(per_m, corner, cell, points[i], x / length, y / length, z / length, length - body))


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _from_afar(portion, per_m, corner, cell, points, ways, left):
    far = cell * sqrt(per_m.shape[0] ** 2 + per_m.shape[1] ** 2 + per_m.shape[2] ** 2)
    for i in range_of(portion, len(points)):
        for k in range(len(ways)):
            left[i, k] = exp(-_depth(per_m, corner, cell, points[i], ways[k, 0], ways[k, 1], ways[k, 2], far))


@kernel(error_model="numpy")
@no_type_check
def _depth(per_m, corner, cell, start, x, y, z, length):
    """Optical depth of a ray from a point, without its first cells, up to a length or to the end of the grid."""
    first = _OWN_CELLS * cell
    if length <= first:
        return 0.0
    steps = ceil((length - first) / cell)
    step, total = (length - first) / steps, 0.0
    for k in range(steps):
        s = first + (k + 0.5) * step
        u = (start[0] + s * x - corner[0]) / cell
        v = (start[1] + s * y - corner[1]) / cell
        w = (start[2] + s * z - corner[2]) / cell
        if not (0 <= u < per_m.shape[0] - 1 and 0 <= v < per_m.shape[1] - 1 and 0 <= w < per_m.shape[2] - 1):
            if (u < 0 and x <= 0) or (v < 0 and y <= 0) or (w < 0 and z <= 0):
                break
            if (u > per_m.shape[0] - 1 and x >= 0) or (v > per_m.shape[1] - 1 and y >= 0) or (
                w > per_m.shape[2] - 1 and z >= 0
            ):  # fmt: skip
                break
            continue
        a, b, c = int(u), int(v), int(w)
        u, v, w = u - a, v - b, w - c
        total += (
            (1 - u) * ((1 - v) * ((1 - w) * per_m[a, b, c] + w * per_m[a, b, c + 1])
                       + v * ((1 - w) * per_m[a, b + 1, c] + w * per_m[a, b + 1, c + 1]))
            + u * ((1 - v) * ((1 - w) * per_m[a + 1, b, c] + w * per_m[a + 1, b, c + 1])
                   + v * ((1 - w) * per_m[a + 1, b + 1, c] + w * per_m[a + 1, b + 1, c + 1]))
        )  # fmt: skip
    return total * step
