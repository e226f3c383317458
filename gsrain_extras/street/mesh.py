"""Colored quads, and surfaces cut into cells; each quad is one Gaussian and two triangles."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64, UInt8

from gsrain_engine.scene.geometry import rotation_about_z
from gsrain_engine.scene.labels import Label

INNER_SPREAD = 0.63
"""Standard deviation of a Gaussian in cell widths, inside a surface: leaves 2 to 4 % of gaps between four cells."""

EDGE_SPREAD = 0.37
"""The same across the edge of a surface, or for an isolated one: keeps outlines in place."""

NEAREST_FIRST = np.array([1.0, 2e-4, -2e-4])
"""Direction from Gaussians that cover to those that are covered, for a camera that looks along the street. Its small
parts decide for surfaces across the street: Gaussians are moved by as little, so that they do."""


@dataclass(frozen=True, slots=True, eq=False)
class Quads:
    """N quadrilaterals in meters, with their material and lighting attributes."""

    corners: Float32[np.ndarray, "n 4 3"]
    """Counter-clockwise from the front; the first edge is u, the last one backwards is v."""
    normals: Float32[np.ndarray, "n 3"]
    """Unit normals for lighting; for leaves those of the crown, not of the leaf."""
    albedo: Float32[np.ndarray, "n 3"]
    """Linear reflectance, 0 to 1."""
    labels: UInt8[np.ndarray, " n"]
    """Values of `Label`."""
    sky_access: Float32[np.ndarray, " n"]
    """Fraction of the sky's light that reaches the surface, before occlusion by the street as a whole."""
    sun_access: Float32[np.ndarray, " n"]
    """Fraction of the sun's light that passes the object itself."""
    gloss: Float32[np.ndarray, " n"]
    """Weight of the mirrored surroundings, 0 to 1."""
    opacity: Float32[np.ndarray, " n"]
    """Largest alpha of the Gaussian; below 0.9 the mesh is translucent there (shadows on the ground)."""
    spread: Float32[np.ndarray, "n 2"]
    """Standard deviation in cell widths along u and v."""
    emission: Float32[np.ndarray, "n 3"]
    """Light of lamps and lit rooms by night, linear; 1 is a camera's white."""
    shift: Float32[np.ndarray, "n 2"]
    """Offset of the Gaussian from the middle of the cell, in cell widths along u and v."""

    def __len__(self) -> int:
        return len(self.corners)

    @property
    def centers(self) -> Float32[np.ndarray, "n 3"]:
        c = self.corners  # as their mean, which takes several times as long along a short axis
        return ((c[:, 0] + c[:, 1] + c[:, 2] + c[:, 3]) / np.float32(4)).astype(np.float32, copy=False)

    @classmethod
    def of(
        cls,
        corners: Float[np.ndarray, "n 4 3"],
        albedo: Any,
        label: Label,
        *,
        normals: Float[np.ndarray, "n 3"] | None = None,
        sky_access: Any = 1.0,
        sun_access: Any = 1.0,
        gloss: Any = 0.0,
        opacity: Any = 0.999,
        spread: Any = INNER_SPREAD,
        emission: Any = 0.0,
    ) -> "Quads":
        """Build quads of one class; single values are broadcast to all of them."""
        n = len(corners)
        return cls(
            np.asarray(corners, np.float32),
            np.asarray(geometric_normals(corners) if normals is None else normals, np.float32),
            np.full((n, 3), albedo, np.float32),
            np.full(n, int(label), np.uint8),
            *(np.full(n, value, np.float32) for value in (sky_access, sun_access, gloss, opacity)),
            spread=np.full((n, 2), spread, np.float32),
            emission=np.full((n, 3), emission, np.float32),
            shift=np.zeros((n, 2), np.float32),
        )

    def take(self, chosen: Any) -> "Quads":
        return Quads(*(getattr(self, name)[chosen] for name in _FIELDS))

    def split(self, counts: Int64[np.ndarray, "n 2"]) -> "Quads":
        """Cut each quad into even cells; `counts` are their numbers along u and v."""
        total = counts[:, 0] * counts[:, 1]
        parent = np.repeat(np.arange(len(self)), total)
        number = np.arange(len(parent)) - np.repeat(np.cumsum(total) - total, total)
        step = 1.0 / counts[parent]
        low = np.stack([number // counts[parent, 1], number % counts[parent, 1]], axis=1) * step
        a, b = (low[:, None, k : k + 1] + _OUTLINE[:, k : k + 1] * step[:, None, k : k + 1] for k in (0, 1))
        c = self.corners[parent].astype(np.float64)
        bottom, top = c[:, :1] + a * (c[:, 1:2] - c[:, :1]), c[:, 3:] + a * (c[:, 2:3] - c[:, 3:])
        return replace(self.take(parent), corners=(bottom + b * (top - bottom)).astype(np.float32))

    def tinted(self, factors: Any) -> "Quads":
        """Multiply the albedo by one color or one factor per quad, clamped to 0 .. 0.95."""
        return replace(self, albedo=np.clip(self.albedo * np.asarray(factors, np.float32), 0, np.float32(0.95)))

    def shining(self, factors: Any) -> "Quads":
        """Multiply the emission by one color or one color per quad; 0 switches lamps off."""
        return replace(self, emission=self.emission * np.asarray(factors, np.float32))

    def placed(self, offset: Any, turn_deg: float = 0.0) -> "Quads":
        """Rotate about z, then translate."""
        corners, normals = self.corners, self.normals
        if turn_deg:
            rotation = rotation_about_z(turn_deg).astype(np.float32)
            corners, normals = corners @ rotation.T, normals @ rotation.T
        return replace(self, corners=corners + np.asarray(offset, np.float32), normals=normals)

    def mirrored(self) -> "Quads":
        """Mirror at the xz plane: y is negated, and the order of corners reversed."""
        flip = np.array([1, -1, 1], np.float32)
        return replace(self, corners=self.corners[:, [1, 0, 3, 2]] * flip, normals=self.normals * flip)

    def repeated(self, offsets: Float[np.ndarray, "m 3"]) -> "Quads":
        """Copies of all quads at each offset, one copy after the other."""
        m = len(offsets)
        columns = {name: np.tile(getattr(self, name), (m,) + (1,) * (getattr(self, name).ndim - 1)) for name in _FIELDS}
        shifts = np.repeat(np.asarray(offsets, np.float32), len(self), axis=0)
        columns["corners"] = columns["corners"] + shifts[:, None]
        return Quads(**columns)

    @staticmethod
    def joined(parts: "Iterable[Quads]") -> "Quads":
        listed = list(parts)
        if not listed:
            return Quads.of(np.zeros((0, 4, 3), np.float32), 0.0, Label.NOTHING)
        return Quads(*(np.concatenate([getattr(part, name) for part in listed]) for name in _FIELDS))


_OUTLINE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])  # corners of a quad along u and v
_FIELDS = ("corners", "normals", "albedo", "labels", "sky_access", "sun_access", "gloss", "opacity", "spread",
           "emission", "shift")  # fmt: skip


def geometric_normals(corners: Float[np.ndarray, "n 4 3"]) -> Float[np.ndarray, "n 3"]:
    """Unit normals from the diagonals; also correct if two corners coincide."""
    a, b = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    # As np.cross and np.linalg.norm, which take several times as long for the few quads of a part.
    normals = a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]
    squares = normals * normals
    lengths = np.sqrt(squares[:, :1] + squares[:, 1:2] + squares[:, 2:])
    return normals / np.maximum(lengths, 1e-12)


# Surfaces cut into cells
# Breaks at color edges; next to them, `refined` cuts them further.


def even_lines(start: float, stop: float, spacing: float) -> Float64[np.ndarray, " n"]:
    """Grid lines of equal distance, at most `spacing`."""
    return np.linspace(start, stop, max(1, round(np.ceil(abs(stop - start) / spacing - 1e-6))) + 1)


def broken_lines(breaks: Sequence[float | int], spacing: float) -> Float64[np.ndarray, " n"]:
    """Grid lines through every break, and evenly between them, at most `spacing` apart."""
    parts = [even_lines(start, stop, spacing)[1:] for start, stop in pairwise(breaks)]
    return np.concatenate([np.array(breaks[:1], np.float64), *parts])


def panel(
    origin: Sequence[float | int],
    u_axis: Sequence[float | int],
    v_axis: Sequence[float | int],
    u_lines: Float64[np.ndarray, " i"],
    v_lines: Float64[np.ndarray, " j"],
    albedo: Any,
    label: Label,
    **more: Any,
) -> Quads:
    """Cut a flat rectangle into cells; it faces u x v. `more` goes to `Quads.of`."""
    u, v = np.asarray(u_axis, np.float64), np.asarray(v_axis, np.float64)
    points = np.asarray(origin, np.float64) + u_lines[:, None, None] * u + v_lines[None, :, None] * v
    return patch(points, albedo, label, **more)


def patch(
    points: Float[np.ndarray, "i j 3"],
    albedo: Any,
    label: Label,
    *,
    keep: Bool[np.ndarray, "a b"] | None = None,
    closed: bool = False,
    **more: Any,
) -> Quads:
    """Make one cell of each mesh of a grid of points; u runs along the first index. It faces u x v.

    `keep` masks cells; `closed` means that the last row of points equals the first one (no edge there).
    """
    i, j = points.shape[0] - 1, points.shape[1] - 1
    corners = np.empty((i, j, 4, 3), points.dtype)
    corners[:, :, 0], corners[:, :, 1] = points[:-1, :-1], points[1:, :-1]
    corners[:, :, 2], corners[:, :, 3] = points[1:, 1:], points[:-1, 1:]
    spread = np.full((i, j, 2), INNER_SPREAD)
    if not closed:
        spread[[0, -1], :, 0] = EDGE_SPREAD
    spread[:, [0, -1], 1] = EDGE_SPREAD
    quads = Quads.of(corners.reshape(-1, 4, 3), albedo, label, **{"spread": spread.reshape(-1, 2), **more})
    return quads if keep is None else quads.take(keep.reshape(-1))


def surface(x: Any, y: Any, z: Any, albedo: Any, label: Label, *, flipped: bool = False, **more: Any) -> Quads:
    """Make a `patch` through points whose coordinates are broadcast to one grid; `flipped` faces the other side."""
    points = np.stack(np.broadcast_arrays(x, y, z), axis=2)
    return patch(points[::-1] if flipped else points, albedo, label, **more)


def box(
    center: Sequence[float | int],
    size: Sequence[float | int],
    albedo: Any,
    label: Label,
    *,
    coarse: float = 0.4,
    faces: str = "xXyYZ",
    **more: Any,
) -> Quads:
    """Cut the faces of an upright box into cells. `faces`: x is the face at -x, X the one at +x, and so on."""
    half = [0.5 * float(s) for s in size]
    low = [float(c) - h for c, h in zip(center, half, strict=True)]
    high = [float(c) + h for c, h in zip(center, half, strict=True)]
    x, y, z = (even_lines(0.0, 2 * h, coarse) for h in half)
    ex, ey, ez = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    sides = {
        "x": (low, ez, ey, z, y),
        "X": ([high[0], low[1], low[2]], ey, ez, y, z),
        "y": (low, ex, ez, x, z),
        "Y": ([low[0], high[1], low[2]], ez, ex, z, x),
        "z": (low, ey, ex, y, x),
        "Z": ([low[0], low[1], high[2]], ex, ey, x, y),
    }
    return Quads.joined(panel(*sides[face], albedo, label, **more) for face in faces)


def tube(
    path: Float[np.ndarray, "i 3"],
    radii: Float[np.ndarray, " i"],
    albedo: Any,
    label: Label,
    *,
    sides: int = 8,
    **more: Any,
) -> Quads:
    """Make a round pole along a path, open at its ends."""
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    reference = np.where(np.abs(along[:, 2:]) > 0.9, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    first = np.cross(reference, along)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(along, first)
    angles = np.linspace(0, 2 * np.pi, sides + 1)[:, None, None]
    rings = np.cos(angles) * first + np.sin(angles) * second
    points = path[None] + radii[None, :, None] * rings
    ends = np.zeros((sides, len(path) - 1))
    ends[:, [0, -1]] = EDGE_SPREAD - INNER_SPREAD
    # Few and strongly bent cells: narrow Gaussians around, or the pole would appear too thick.
    spread = np.stack([np.full_like(ends, EDGE_SPREAD), INNER_SPREAD + ends], axis=2).reshape(-1, 2)
    return patch(points, albedo, label, closed=True, **{"spread": spread, **more})
