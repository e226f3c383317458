"""Smooth solids from distance functions, meshed by surface nets: what is neither flat nor round about one axis.

Each `Solid` is a distance function in a box; `mesh_solids` blends them where they meet, and returns quads with smooth
normals, the solid that owns each quad, and the sky's light that the shape itself leaves (ambient occlusion).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float64, Int64

Point = tuple[float, float, float]
Distance = Callable[[Float64[np.ndarray, "*n 3"]], Float64[np.ndarray, "*n"]]


class Solid(NamedTuple):
    """A solid with its material."""

    low: Point
    high: Point
    """Corners of the box around it, in meters."""
    distance: Distance
    """Distance to its surface in meters at points (..., 3), negative inside; near the surface, about right."""
    material: int
    blend: float = 0.02
    """Width in meters over which it merges with the solids before it."""


class SolidMesh(NamedTuple):
    """Quads around solids."""

    corners: Float64[np.ndarray, "n 4 3"]
    normals: Float64[np.ndarray, "n 3"]
    materials: Int64[np.ndarray, " n"]
    sky_access: Float64[np.ndarray, " n"]
    """Share of the hemisphere over each quad that the solids leave, 0..1."""
    field: "DistanceField"

    @property
    def centers(self) -> Float64[np.ndarray, "n 3"]:
        return self.corners.mean(axis=1)


class DistanceField(NamedTuple):
    """Distances on a grid."""

    origin: Float64[np.ndarray, "3"]
    cell: float
    values: Float64[np.ndarray, "i j k"]

    def at(self, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
        """Trilinear; outside of the grid, far from everything."""
        scaled = (points - self.origin) / self.cell
        limit = np.array(self.values.shape) - 1.001
        inside = ((scaled >= 0) & (scaled <= limit)).all(axis=1)
        scaled = np.clip(scaled, 0, limit)
        cells = scaled.astype(np.int64)
        (a, b, c), (i, j, k) = (scaled - cells).T, cells.T
        v = self.values
        low = (v[i, j, k] * (1 - a) + v[i + 1, j, k] * a) * (1 - b)
        low += (v[i, j + 1, k] * (1 - a) + v[i + 1, j + 1, k] * a) * b
        high = (v[i, j, k + 1] * (1 - a) + v[i + 1, j, k + 1] * a) * (1 - b)
        high += (v[i, j + 1, k + 1] * (1 - a) + v[i + 1, j + 1, k + 1] * a) * b
        return np.where(inside, low * (1 - c) + high * c, _FAR_M)

    def lit(
        self, points: Float64[np.ndarray, "n 3"], sun: Float64[np.ndarray, "3"], reach_m: float = 0.6
    ) -> Float64[np.ndarray, " n"]:
        """Share of a sun that the solids leave at points on them: the nearest miss of the ray, relative to its way."""
        share = np.ones(len(points))
        for way in np.geomspace(1.6 * self.cell, reach_m, 9):
            share = np.minimum(share, 0.5 + 6.0 * self.at(points + way * sun) / way)
        return np.clip(share, 0, 1)


_FAR_M = 0.16  # distances are known up to here
_MARGIN_M = 0.13
_OCCLUSION_M = 0.03, 0.06, 0.12


def mesh_solids(solids: Sequence[Solid], cell: float) -> SolidMesh:
    """Mesh the union of solids into quads of about one cell, in meters (surface nets, Gibson 1998).

    Each cell of a grid that the surface crosses has one corner, the mean of the crossings of its edges; each edge that
    the surface crosses has one quad, between the four cells around it.
    """
    low = np.min([solid.low for solid in solids], axis=0) - 2 * cell
    high = np.max([solid.high for solid in solids], axis=0) + 2 * cell
    shape = tuple(np.ceil((high - low) / cell).astype(int) + 1)
    values, owner = np.full(shape, _FAR_M), np.zeros(shape, np.int64)
    closest = np.full(shape, np.inf)
    for number, solid in enumerate(solids):
        first = np.maximum(np.floor((np.array(solid.low) - _MARGIN_M - low) / cell), 0).astype(int)
        last = np.minimum(np.ceil((np.array(solid.high) + _MARGIN_M - low) / cell).astype(int) + 1, shape)
        part = tuple(slice(int(a), int(b)) for a, b in zip(first, last, strict=True))
        axes = (low[k] + cell * np.arange(first[k], last[k]) for k in range(3))
        distance = solid.distance(np.stack(np.meshgrid(*axes, indexing="ij"), axis=3))
        before = values[part]
        overlap = np.maximum(solid.blend - np.abs(before - distance), 0) / solid.blend
        values[part] = np.minimum(before, distance) - 0.25 * solid.blend * overlap**2
        nearer = distance < closest[part]
        owner[part] = np.where(nearer, number, owner[part])
        closest[part] = np.where(nearer, distance, closest[part])
    corners, inner = _surface_net(values)
    field = DistanceField(low, cell, values)
    corners = low + cell * corners
    centers = corners.mean(axis=1)
    normals = _gradient(field, centers)
    access = np.mean([np.clip(field.at(centers + h * normals) / h, 0, 1) for h in _OCCLUSION_M], axis=0)
    materials = np.array([solid.material for solid in solids])[owner[tuple(inner.T)]]
    return SolidMesh(corners, normals, materials, access, field)


def _gradient(field: DistanceField, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    step = 0.7 * field.cell * np.eye(3)
    slopes = np.stack([field.at(points + each) - field.at(points - each) for each in step], axis=1)
    return slopes / np.maximum(np.linalg.norm(slopes, axis=1, keepdims=True), 1e-12)


def _surface_net(values: Float64[np.ndarray, "i j k"]) -> tuple[Float64[np.ndarray, "n 4 3"], Int64[np.ndarray, "n 3"]]:
    """Corners of quads in cells of the grid, and the grid's point inside the solid next to each quad."""
    inside = values < 0
    total = np.zeros((*(n - 1 for n in values.shape), 3))
    count = np.zeros(total.shape[:3])
    crossings: list[tuple[int, Int64[np.ndarray, "m 3"], Bool[np.ndarray, " m"]]] = []
    for axis in range(3):
        at = np.argwhere(np.diff(inside, axis=axis))
        further = at.copy()
        further[:, axis] += 1
        a, b = values[tuple(at.T)], values[tuple(further.T)]
        crossing = at.astype(np.float64)
        crossing[:, axis] += a / (a - b)
        others = [k for k in range(3) if k != axis]
        free = ((at[:, others] > 0) & (at[:, others] < np.array(values.shape)[others] - 1)).all(axis=1)
        at, crossing, starts_inside = at[free], crossing[free], a[free] < 0
        for du, dv in _AROUND:
            cells = at.copy()
            cells[:, others[0]] += du
            cells[:, others[1]] += dv
            np.add.at(total, tuple(cells.T), crossing)
            np.add.at(count, tuple(cells.T), 1)
        crossings.append((axis, at, starts_inside))
    middle = total / np.maximum(count, 1)[..., None]
    corners: list[Float64[np.ndarray, "m 4 3"]] = []
    inner: list[Int64[np.ndarray, "m 3"]] = []
    for axis, at, starts_inside in crossings:
        others = [k for k in range(3) if k != axis]
        around: list[Float64[np.ndarray, "m 3"]] = []
        for du, dv in _AROUND:
            cells = at.copy()
            cells[:, others[0]] += du
            cells[:, others[1]] += dv
            around.append(middle[tuple(cells.T)])
        quad = np.stack(around, axis=1)
        # Counter-clockwise about the axis for x and z; y runs against the order of the other two.
        outwards = starts_inside ^ (axis == 1)
        corners.append(np.where(outwards[:, None, None], quad, quad[:, ::-1]))
        within = at.copy()
        within[:, axis] += ~starts_inside
        inner.append(within)
    return np.concatenate(corners), np.concatenate(inner)


_AROUND = ((-1, -1), (0, -1), (0, 0), (-1, 0))  # cells around an edge, along the other two axes


# Distance functions


def round_cone(a: Point, b: Point, radius_a: float, radius_b: float, material: int, blend: float = 0.02) -> Solid:
    """A limb: the hull of two spheres."""
    start, end = np.array(a), np.array(b)
    along = end - start
    squared = float(along @ along)

    def distance(points: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n"]:
        t = np.clip((points - start) @ along / squared, 0, 1)
        return np.linalg.norm(points - start - t[..., None] * along, axis=-1) - (radius_a + t * (radius_b - radius_a))

    low = np.minimum(start - radius_a, end - radius_b)
    high = np.maximum(start + radius_a, end + radius_b)
    return Solid(_point(low), _point(high), distance, material, blend)


def ellipsoid(center: Point, radii: Point, material: int, blend: float = 0.02) -> Solid:
    middle, axes = np.array(center), np.array(radii)

    def distance(points: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n"]:
        local = (points - middle) / axes
        far = np.linalg.norm(local, axis=-1)
        return far * (far - 1) / np.maximum(np.linalg.norm(local / axes, axis=-1), 1e-9)

    return Solid(_point(middle - axes), _point(middle + axes), distance, material, blend)


class Section(NamedTuple):
    """An upright loft's outline at a height: half its depth (x) and width (y), and its middle, in meters."""

    z: float
    depth: float
    width: float
    x: float = 0.0
    y: float = 0.0


def loft(
    sections: Sequence[Section], material: int, *, power: float = 2.3, folds: float = 0.0, blend: float = 0.02
) -> Solid:
    """Upright body through superelliptic sections, by rising z; `folds` in meters wrinkle it as cloth."""
    z, depth, width, x, y = (np.array(column, np.float64) for column in zip(*sections, strict=True))

    def distance(points: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n"]:
        px, py, pz = points[..., 0], points[..., 1], points[..., 2]
        d, w = np.interp(pz, z, depth), np.interp(pz, z, width)
        u, v = (px - np.interp(pz, z, x)) / d, (py - np.interp(pz, z, y)) / w
        far = (np.abs(u) ** power + np.abs(v) ** power) ** (1 / power)
        aside = (far - 1) * np.minimum(d, w)
        if folds:
            turn = np.arctan2(v, u)
            aside = aside + folds * np.sin(3 * turn + 17 * pz) * np.sin(34 * pz + 5 * turn + 1.3)
        return np.maximum(aside, np.maximum(z[0] - pz, pz - z[-1]))

    low = (float((x - depth).min()), float((y - width).min()), float(z[0]))
    high = (float((x + depth).max()), float((y + width).max()), float(z[-1]))
    return Solid(low, high, distance, material, blend)


def round_box(center: Point, size: Point, radius: float, material: int, blend: float = 0.005) -> Solid:
    """An upright box with round edges."""
    middle, half = np.array(center), np.array(size) / 2

    def distance(points: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n"]:
        over = np.abs(points - middle) - (half - radius)
        return np.linalg.norm(np.maximum(over, 0), axis=-1) + np.minimum(over.max(axis=-1), 0) - radius

    return Solid(_point(middle - half), _point(middle + half), distance, material, blend)


def cut(solid: Solid, normal: Point, offset: float) -> Solid:
    """Keep the part of a solid with normal . p <= offset; `normal` has unit length."""

    def distance(points: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n"]:
        return np.maximum(solid.distance(points), points @ np.array(normal) - offset)

    return solid._replace(distance=distance)


def _point(values: Float[np.ndarray, "3"]) -> Point:
    x, y, z = values.tolist()
    return x, y, z
