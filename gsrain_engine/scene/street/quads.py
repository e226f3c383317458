"""Coloured quadrilaterals: each is one Gaussian of the street and two triangles of its mesh."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, UInt8

from .labels import Label

INNER_SPREAD = 0.63
"""A Gaussian's standard deviation in cell widths, inside a surface: leaves 2 to 4 % of gaps between four cells."""
EDGE_SPREAD = 0.42
"""The same across the edge of a surface, or for one that stands alone: keeps outlines where they are."""


@dataclass(frozen=True, slots=True, eq=False)
class Quads:
    """N quadrilaterals in metres, with what light needs to know about them."""

    corners: Float32[np.ndarray, "n 4 3"]
    """Counter-clockwise as seen from the front; the first edge is u, the last one backwards is v."""
    normals: Float32[np.ndarray, "n 3"]
    """Unit normals that light uses; for leaves those of the crown, not of the leaf."""
    albedo: Float32[np.ndarray, "n 3"]
    """Linear reflectance, 0 to 1."""
    labels: UInt8[np.ndarray, " n"]
    """Values of `Label`."""
    sky_access: Float32[np.ndarray, " n"]
    """Share of the sky's light that reaches the surface, before what the street as a whole takes away."""
    sun_access: Float32[np.ndarray, " n"]
    """Share of the sun's light that the object itself lets through."""
    gloss: Float32[np.ndarray, " n"]
    """How much of the mirrored surroundings is added, 0 to 1."""
    opacity: Float32[np.ndarray, " n"]
    """Largest alpha of the Gaussian; below 0.9 the mesh shows it half transparent (shadows on the ground)."""
    spread: Float32[np.ndarray, "n 2"]
    """Standard deviation in cell widths along u and v."""

    def __len__(self) -> int:
        return len(self.corners)

    @property
    def centers(self) -> Float32[np.ndarray, "n 3"]:
        return self.corners.mean(axis=1, dtype=np.float32)

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
    ) -> "Quads":
        """Build quads of one class; single values are spread over all of them."""
        n = len(corners)
        return cls(
            np.asarray(corners, np.float32),
            np.asarray(geometric_normals(corners) if normals is None else normals, np.float32),
            _filled(albedo, (n, 3)),
            np.full(n, int(label), np.uint8),
            _filled(sky_access, (n,)),
            _filled(sun_access, (n,)),
            _filled(gloss, (n,)),
            _filled(opacity, (n,)),
            _filled(spread, (n, 2)),
        )

    def take(self, chosen: Any) -> "Quads":
        """Pick quads by mask or index."""
        return Quads(*(getattr(self, name)[chosen] for name in _FIELDS))

    def tinted(self, factors: Any) -> "Quads":
        """Multiply the albedo, by one colour or one factor a quad, and keep it within 0 to 0.95."""
        tinted = self.albedo * np.asarray(factors, np.float32)
        return replace(self, albedo=np.clip(tinted, 0, np.float32(0.95)))

    def placed(self, offset: Any, turn_deg: float = 0.0) -> "Quads":
        """Turn about z, then move."""
        if turn_deg:
            turned = self.turned(rotation_about_z(turn_deg))
        else:
            turned = self
        return replace(turned, corners=turned.corners + np.asarray(offset, np.float32))

    def turned(self, rotation: Float[np.ndarray, "3 3"]) -> "Quads":
        """Apply a rotation to places and normals."""
        matrix = np.asarray(rotation, np.float32)
        return replace(self, corners=self.corners @ matrix.T, normals=self.normals @ matrix.T)

    def mirrored(self) -> "Quads":
        """The same on the other side of the xz plane: y is negated, and corners run the other way round."""
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
        """All quads of all parts, in order."""
        listed = list(parts)
        if not listed:
            return Quads.of(np.zeros((0, 4, 3), np.float32), 0.0, Label.NOTHING)
        return Quads(*(np.concatenate([getattr(part, name) for part in listed]) for name in _FIELDS))


_FIELDS = ("corners", "normals", "albedo", "labels", "sky_access", "sun_access", "gloss", "opacity", "spread")


def _filled(value: Any, shape: tuple[int, ...]) -> Any:
    return np.full(shape, value, np.float32)


def geometric_normals(corners: Float[np.ndarray, "n 4 3"]) -> Float[np.ndarray, "n 3"]:
    """Unit normals from the diagonals; also right where two corners fall together."""
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.maximum(lengths, 1e-12)


def rotation_about_z(degrees: float) -> Float[np.ndarray, "3 3"]:
    """Counter-clockwise as seen from above."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
