"""Occlusion of a scene's far parts by its near ones, in cells of an image: cuts leave out what is hidden."""

import math
from collections.abc import Iterable
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt32

from ..kernels import kernel, range_of
from .camera import Camera
from .gaussians import Gaussians

CELL_PX = 5
"""Side of a cell of the map."""

_HIDDEN = math.log(0.01)  # logarithm of the transmittance in front of what is hidden
_SLICE_BITS = 20  # bits of a depth as float32 that differ inside a slice: eight slices from 1 to 2 m, 2 to 4 m, ...
_FIRST_SLICE = 127 << 3  # the bits above those at 1 m; all that is nearer is in the same slice
_SLICES = 88
_STRIPES = 8  # of columns, which are processed in parallel; the result does not depend on it
_FOOTPRINT = 0.1  # variance of a cell's own area, as the pixel's in images (Mip-Splatting, Yu et al. 2024)
_GROWTH = 1.5  # of variances: light seems to come through gaps between merged Gaussians, which images don't have
_REACH = 1.6  # standard deviations to which a Gaussian occludes
_MIN_ALPHA = 0.05  # of a Gaussian that occludes
_NEAR_M = 0.2
_STEPS = 256
_LOG_TRANSMITTANCES = np.log1p(-np.minimum((np.arange(_STEPS + 1) + 0.5) / _STEPS, 0.99)).astype(np.float32)
"""Logarithm of 1 - alpha, by alpha in steps."""


class OcclusionMap(NamedTuple):
    """Depth behind which each cell of an image is hidden, and the maxima of 2 x 2 cells, of 4 x 4, and so on."""

    depths_m: Float32[np.ndarray, " d"]
    """Depths of all levels, each column by column."""
    levels: Int64[np.ndarray, "l 3"]
    """Columns and rows of each level, and its start in `depths_m`; none if nothing is hidden."""

    @property
    def cells(self) -> Float32[np.ndarray, "columns rows"]:
        """Depths of single cells; infinite where the scene is open."""
        columns, rows, _ = self.levels[0]
        return self.depths_m[: columns * rows].reshape(columns, rows)


def nothing_hidden() -> OcclusionMap:
    return OcclusionMap(np.zeros(0, np.float32), np.zeros((0, 3), np.int64))


def occlusion_map(
    occluders: Iterable[
        tuple[Gaussians, UInt32[np.ndarray, " n"] | Int64[np.ndarray, " n"], Float64[np.ndarray, "4 4"]]
    ],
    camera: Camera,
) -> OcclusionMap:
    """Find the depths from which on the transmittance of occluders is below 1 % in the cells of a pinhole image.

    An occluder is a set of Gaussians, the indices of those that count, and the similarity to the camera's world. Each
    counts where its center is: alpha in the middle of cells, blurred by their area, is multiplied up in slices of depth
    whose ends are 6 to 13 % apart. The same for any number of threads.
    """
    columns, rows = -(-camera.width // CELL_PX), -(-camera.height // CELL_PX)
    found = [_project(*each, camera) for each in occluders]
    found = [each for each in found if len(each[0])]
    if not found:
        return nothing_hidden()
    boxes, ellipses = (np.concatenate(each) for each in zip(*found, strict=True))
    sizes = [(columns, rows)]
    while max(sizes[-1]) > 1:
        sizes.append((-(-sizes[-1][0] // 2), -(-sizes[-1][1] // 2)))
    areas = [width * height for width, height in sizes]
    starts = np.cumsum([0, *areas])
    levels = np.array([(*size, start) for size, start in zip(sizes, starts[:-1], strict=True)], np.int64)
    depths_m = np.empty(int(starts[-1]), np.float32)
    _find_depths(boxes, ellipses, _LOG_TRANSMITTANCES, depths_m[: areas[0]].reshape(columns, rows))
    _find_maxima(levels, depths_m)
    return OcclusionMap(depths_m, levels)


def _project(
    gaussians: Gaussians, members: np.ndarray, to_world: Float64[np.ndarray, "4 4"], camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    g, c = gaussians, camera
    boxes, ellipses = np.empty((len(members), 5), np.int16), np.empty((len(members), 6), np.float32)
    m = np.ascontiguousarray(c.world_to_camera @ to_world, np.float64)
    view = tuple(float(each) / CELL_PX for each in (c.fx, c.fy, c.cx, c.cy, c.width, c.height))
    _write_ellipses(members, g.means, g.scales, g.quaternions, g.opacities, m, view, boxes, ellipses)
    return boxes, ellipses


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _write_ellipses(portion, members, means, scales, quaternions, opacities, m, view, boxes, ellipses):
    """Write the cells that each Gaussian covers and its slice, -1 for none; and center, inverse covariance and alpha.

    The projection is that of images, in cells.
    """
    fx, fy, cx, cy, width, height = view
    columns, rows = np.ceil(width), np.ceil(height)
    for n in range_of(portion, len(members)):
        i = members[n]
        boxes[n, 4] = -1
        mx, my, mz = np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2])
        px = m[0, 0] * mx + m[0, 1] * my + m[0, 2] * mz + m[0, 3]
        py = m[1, 0] * mx + m[1, 1] * my + m[1, 2] * mz + m[1, 3]
        pz = m[2, 0] * mx + m[2, 1] * my + m[2, 2] * mz + m[2, 3]
        if not (pz > _NEAR_M and opacities[i] >= _MIN_ALPHA):
            continue
        near = 1 / pz
        slope_x = min(max(fx * px * near, -cx - 0.15 * width), width - cx + 0.15 * width)
        slope_y = min(max(fy * py * near, -cy - 0.15 * height), height - cy + 0.15 * height)
        ux, vx = near * (fx * m[0, 0] - slope_x * m[2, 0]), near * (fy * m[1, 0] - slope_y * m[2, 0])
        uy, vy = near * (fx * m[0, 1] - slope_x * m[2, 1]), near * (fy * m[1, 1] - slope_y * m[2, 1])
        uz, vz = near * (fx * m[0, 2] - slope_x * m[2, 2]), near * (fy * m[1, 2] - slope_y * m[2, 2])
        w, x = np.float64(quaternions[i, 0]), np.float64(quaternions[i, 1])
        y, z = np.float64(quaternions[i, 2]), np.float64(quaternions[i, 3])
        a, b, c = np.float64(scales[i, 0]), np.float64(scales[i, 1]), np.float64(scales[i, 2])
        rx, ry, rz = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
        u0, v0 = a * (ux * rx + uy * ry + uz * rz), a * (vx * rx + vy * ry + vz * rz)
        rx, ry, rz = 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)
        u1, v1 = b * (ux * rx + uy * ry + uz * rz), b * (vx * rx + vy * ry + vz * rz)
        rx, ry, rz = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
        u2, v2 = c * (ux * rx + uy * ry + uz * rz), c * (vx * rx + vy * ry + vz * rz)
        xx, xy = _GROWTH * (u0 * u0 + u1 * u1 + u2 * u2), _GROWTH * (u0 * v0 + u1 * v1 + u2 * v2)
        yy = _GROWTH * (v0 * v0 + v1 * v1 + v2 * v2)
        before = max(xx * yy - xy * xy, 0.0)
        xx, yy = xx + _FOOTPRINT, yy + _FOOTPRINT
        determinant = xx * yy - xy * xy
        alpha = min(np.float64(opacities[i]), 1.0) * np.sqrt(before / determinant)
        u, v = fx * px * near + cx - 0.5, fy * py * near + cy - 0.5
        left, right = max(np.ceil(u - _REACH * np.sqrt(xx)), 0.0), min(np.floor(u + _REACH * np.sqrt(xx)), columns - 1)
        top, bottom = max(np.ceil(v - _REACH * np.sqrt(yy)), 0.0), min(np.floor(v + _REACH * np.sqrt(yy)), rows - 1)
        # Numbers that are not finite fail the comparisons.
        if alpha >= _MIN_ALPHA and left <= right and top <= bottom and pz < 1e30:
            boxes[n, 0], boxes[n, 1], boxes[n, 2], boxes[n, 3] = left, right, top, bottom
            bits = np.float32(pz).view(np.int32)
            boxes[n, 4] = min(max((bits >> _SLICE_BITS) - _FIRST_SLICE, 0), _SLICES - 1)
            ellipses[n, 0], ellipses[n, 1], ellipses[n, 5] = u, v, _STEPS * alpha
            ellipses[n, 2], ellipses[n, 3] = -0.5 * yy / determinant, xy / determinant
            ellipses[n, 4] = -0.5 * xx / determinant


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _find_depths(portion, boxes, ellipses, logarithms, depths_m):
    """Add up logarithms of transmittances in each cell and slice, and find the first slice that hides the next ones."""
    columns, rows = depths_m.shape
    wide = (columns + _STRIPES - 1) // _STRIPES
    for stripe in range_of(portion, _STRIPES):
        first, last = stripe * wide, min(columns, (stripe + 1) * wide)
        sums = np.zeros((max(last - first, 0), _SLICES, rows), np.float32)
        for n in range(len(boxes)):
            if boxes[n, 4] < 0 or boxes[n, 0] >= last or boxes[n, 1] < first:
                continue
            u, v, aa, ab, bb, steps = ellipses[n]
            top, bottom, part = boxes[n, 2], boxes[n, 3], boxes[n, 4]
            second = np.exp(2 * bb)
            for column in range(max(np.int64(boxes[n, 0]), first), min(np.int64(boxes[n, 1]) + 1, last)):
                # Down a column, the ratio of neighboring alphas changes by the same factor from cell to cell.
                x, y = np.float32(column) - u, np.float32(top) - v
                step = steps * np.exp(aa * x * x + ab * x * y + bb * y * y)
                ratio = np.exp(bb * (2 * y + np.float32(1)) + ab * x)
                line = sums[column - first, part]
                for row in range(top, bottom + 1):
                    line[row] += logarithms[np.int32(step)]
                    step *= ratio
                    ratio *= second
        total = np.empty(rows, np.float32)
        for column in range(first, last):
            total[:] = 0
            depths_m[column] = np.inf
            for part in range(_SLICES - 1):
                end = np.int32((_FIRST_SLICE + part + 1) << _SLICE_BITS).view(np.float32)
                line = sums[column - first, part]
                for row in range(rows):
                    total[row] += line[row]
                    hidden = total[row] < np.float32(_HIDDEN)
                    depths_m[column, row] = min(depths_m[column, row], end if hidden else np.float32(np.inf))


@kernel()
@no_type_check
def _find_maxima(levels, depths_m):
    for level in range(1, len(levels)):
        columns, rows, start = levels[level]
        finer_columns, finer_rows, finer = levels[level - 1]
        for column in range(columns):
            for row in range(rows):
                farthest = np.float32(0)
                for u in range(2 * column, min(2 * column + 2, finer_columns)):
                    for v in range(2 * row, min(2 * row + 2, finer_rows)):
                        farthest = max(farthest, depths_m[finer + u * finer_rows + v])
                depths_m[start + column * rows + row] = farthest
