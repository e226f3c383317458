"""3D Gaussians, their spherical harmonics, and caches by scene identity."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, ParamSpec, TypeVar

import numpy as np
from jaxtyping import Float, Float32, Float64, Int, UInt32

from ..safe_io.foreign_values import as_array

SH_C0 = 0.28209479177387814
"""Spherical harmonic of degree 0, 1/(2 sqrt(pi)): color = SH_C0 * sh[0] + 0.5 (3DGS, Kerbl et al. 2023)."""

COEFFICIENTS_OF_DEGREE = (1, 4, 9, 16)
"""Number of spherical harmonics up to degree 0, 1, 2, 3."""


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Gaussians:
    """N Gaussians, activated: logs and logits exist only in file formats and optimizers.

    Treat the arrays as immutable. Lists, tensors and arrays of other types become arrays of float32.
    """

    means: Float32[np.ndarray, "n 3"]
    """Centers, in the units and axes of their layer."""
    scales: Float32[np.ndarray, "n 3"]
    """Standard deviations along the Gaussian's own axes, >= 0, same unit as `means`."""
    quaternions: Float32[np.ndarray, "n 4"]
    """Own axes to layer axes, (w, x, y, z), unit."""
    opacities: Float32[np.ndarray, " n"]
    """Largest alpha, in [0, 1]."""
    sh: Float32[np.ndarray, "n k 3"]
    """Spherical harmonics of display color, k = 1, 4, 9 or 16, in the order and sign of 3DGS."""
    antialiased: bool = field(default=False, kw_only=True)
    """True if they are to be drawn through the pixel's filter of Mip-Splatting (Yu et al. 2024), as they were trained:
    sharper than that of 3DGS, and with the integral of alpha over the image kept, so that thin ones don't grow.
    `cuda` and training draw them like others."""

    def __post_init__(self) -> None:
        for name in ("means", "scales", "quaternions", "opacities", "sh"):
            object.__setattr__(self, name, as_array(getattr(self, name), np.float32, f"Gaussians.{name}"))
        if self.sh.ndim != 3:
            raise ValueError(f"Gaussians.sh has shape {self.sh.shape}, expected (N, 1, 4, 9 or 16, 3)")
        n, k = len(self.means), self.sh.shape[1]
        shapes = {"means": (n, 3), "scales": (n, 3), "quaternions": (n, 4), "opacities": (n,), "sh": (n, k, 3)}
        for name, shape in shapes.items():
            found = getattr(self, name).shape
            if found != shape:
                raise ValueError(f"Gaussians.{name} has shape {found}, expected {shape}")
        if k not in COEFFICIENTS_OF_DEGREE:
            raise ValueError(f"Gaussians.sh has {k} coefficients a color, expected one of {COEFFICIENTS_OF_DEGREE}")

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        return COEFFICIENTS_OF_DEGREE.index(self.sh.shape[1])

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """The five arrays, in the order of the fields."""
        return self.means, self.scales, self.quaternions, self.opacities, self.sh

    @property
    def nbytes(self) -> int:
        return sum(array.nbytes for array in self.arrays)

    def take(self, indices: "Int[np.ndarray, ' m'] | UInt32[np.ndarray, ' m'] | slice") -> "Gaussians":
        """Pick Gaussians by index or slice, in that order."""
        return Gaussians(*(array[indices] for array in self.arrays), antialiased=self.antialiased)

    def with_sh(self, sh: Float32[np.ndarray, "n k 3"]) -> "Gaussians":
        return replace(self, sh=sh)

    @staticmethod
    def empty(sh_degree: int = 0) -> "Gaussians":
        shapes = (0, 3), (0, 3), (0, 4), (0,), (0, COEFFICIENTS_OF_DEGREE[sh_degree], 3)
        return Gaussians(*(np.zeros(shape, np.float32) for shape in shapes))

    @staticmethod
    def concatenate(parts: Sequence["Gaussians"]) -> "Gaussians":
        """Join sets in order; lower SH degrees are padded with zeros to the highest one.

        Returns a single set itself. The result is antialiased if the larger part of it was.
        """
        if len(parts) < 2:
            return parts[0] if parts else Gaussians.empty()
        k = max(part.sh.shape[1] for part in parts)
        lacking = ((part.sh, k - part.sh.shape[1]) for part in parts)
        padded = [np.pad(sh, ((0, 0), (0, more), (0, 0))) if more else sh for sh, more in lacking]
        columns = zip(*(part.arrays[:-1] for part in parts), strict=True)
        antialiased = 2 * sum(len(part) for part in parts if part.antialiased) > sum(map(len, parts))
        return Gaussians(*map(np.concatenate, columns), sh=np.concatenate(padded), antialiased=antialiased)


def sh_from_color(colors: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 1 3"]:
    """Spherical harmonics of degree 0 with the same display color (0..1) from every direction."""
    return ((colors - np.float32(0.5)) / np.float32(SH_C0))[:, None, :]


# Spherical harmonics

_SAMPLES = 64  # sample directions for the matrices of a rotation; degree 3 has 7 unknowns per row


def sh_basis(directions: Float[np.ndarray, "*n 3"], coefficients: int) -> Float[np.ndarray, "*n k"]:
    """Values of the first 1, 4, 9 or 16 harmonics in unit directions (eye to Gaussian), in the directions' precision.

    Real harmonics in the order and sign of 3DGS (Kerbl et al. 2023), the same as in `common_spherical_harmonics.glsl`.
    """
    x, y, z = np.moveaxis(directions, -1, 0)
    basis = [np.full_like(x, 0.28209479177387814)]
    if coefficients > 1:
        basis += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if coefficients > 4:
        basis += [
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * z * z - x * x - y * y),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (x * x - y * y),
        ]
    if coefficients > 9:
        basis += [
            -0.5900435899266435 * y * (3 * x * x - y * y),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
            0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -0.4570457994644658 * x * (4 * z * z - x * x - y * y),
            1.445305721320277 * z * (x * x - y * y),
            -0.5900435899266435 * x * (x * x - 3 * y * y),
        ]
    return np.stack(basis, axis=-1)


def evaluate_sh(sh: Float[np.ndarray, "n k 3"], directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Display colors for one direction (unit, eye to Gaussian) per Gaussian; unclamped, so they may leave 0..1."""
    return np.einsum("nk,nkc->nc", sh_basis(directions, sh.shape[1]), sh) + sh.dtype.type(0.5)


def rotate_sh(sh: Float32[np.ndarray, "n k 3"], rotation: Float[np.ndarray, "3 3"]) -> Float32[np.ndarray, "n k 3"]:
    """Rotate coefficients: `evaluate_sh(rotate_sh(sh, R), R @ d)` is `evaluate_sh(sh, d)`.

    `rotation` is orthonormal (mirroring included): it transforms every degree within itself.
    """
    turned = sh.copy()
    degrees = COEFFICIENTS_OF_DEGREE.index(sh.shape[1])
    for degree, matrix in enumerate(_rotation_matrices(rotation, degrees), start=1):
        band = slice(degree**2, (degree + 1) ** 2)
        # One matrix product for all three colors is several times faster than one for each.
        of_colors = np.kron(matrix, np.eye(3)).astype(np.float32).T
        turned[:, band] = (sh[:, band].reshape(len(sh), len(of_colors)) @ of_colors).reshape(len(sh), len(matrix), 3)
    return turned


def _rotation_matrices(rotation: Float[np.ndarray, "3 3"], degrees: int) -> list[Float64[np.ndarray, "m m"]]:
    """One matrix per degree from 1 on, solved from samples: basis(R d) @ turned = basis(d) @ coefficients for all d."""
    directions = _spread_directions(_SAMPLES)
    before = sh_basis(directions, 16)
    after = sh_basis(directions @ np.asarray(rotation, np.float64).T, 16)
    bands = [slice(degree**2, (degree + 1) ** 2) for degree in range(1, degrees + 1)]
    return [np.linalg.lstsq(after[:, band], before[:, band], rcond=None)[0] for band in bands]


def _spread_directions(count: int) -> Float64[np.ndarray, "n 3"]:
    """Unit directions that cover the sphere evenly: a Fibonacci lattice."""
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    angle = index * (np.pi * (3 - np.sqrt(5)))
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)


# Caches by identity

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")
_CACHES: list[Any] = []


@dataclass(frozen=True, slots=True, eq=False)
class IdentityKey:
    """Wrapper that compares by identity; it references the object, so that its id is not reused."""

    of: object

    def __eq__(self, other: object) -> bool:
        return isinstance(other, IdentityKey) and self.of is other.of

    def __hash__(self) -> int:
        return id(self.of)


def scene_cache(maxsize: int) -> Callable[[Callable[_Parameters, _Result]], Callable[_Parameters, _Result]]:
    """Decorate a function of scenes or Gaussians to cache its last `maxsize` results until `forget_scenes`."""

    def decorate(function: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
        cached = lru_cache(maxsize)(function)
        _CACHES.append(cached)
        return cached  # pyright: ignore[reportReturnType]

    return decorate


def forget_scenes() -> None:
    """Clear all caches of `scene_cache`, whose results hold references to their scenes."""
    for each in _CACHES:
        each.cache_clear()
