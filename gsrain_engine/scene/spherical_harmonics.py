"""Spherical harmonics of display colour up to degree 3: their values, and what a turn makes of them."""

import numpy as np
from jaxtyping import Float, Float32, Float64

from .gaussians import COEFFICIENTS_OF_DEGREE

_SAMPLES = 64
"""Directions that the matrices of a rotation are solved from; degree 3 has 7 unknowns a row."""


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
    """Display colours, one direction (unit, eye to Gaussian) a Gaussian; they may leave 0..1: nothing is clamped."""
    return np.einsum("nk,nkc->nc", sh_basis(directions, sh.shape[1]), sh) + sh.dtype.type(0.5)


def rotate_sh(sh: Float32[np.ndarray, "n k 3"], rotation: Float[np.ndarray, "3 3"]) -> Float32[np.ndarray, "n k 3"]:
    """Coefficients of the same colours after a turn: `evaluate_sh(rotate_sh(sh, R), R @ d)` is `evaluate_sh(sh, d)`.

    `rotation` is orthonormal (a mirroring is allowed, too): every degree then turns within itself.
    """
    turned = sh.copy()
    degrees = COEFFICIENTS_OF_DEGREE.index(sh.shape[1])
    for degree, matrix in enumerate(_rotation_matrices(rotation, degrees), start=1):
        band = slice(degree**2, (degree + 1) ** 2)
        # One product of matrices for all three colours is several times faster than one for each.
        of_colors = np.kron(matrix, np.eye(3)).astype(np.float32).T
        turned[:, band] = (sh[:, band].reshape(len(sh), len(of_colors)) @ of_colors).reshape(len(sh), len(matrix), 3)
    return turned


def _rotation_matrices(rotation: Float[np.ndarray, "3 3"], degrees: int) -> list[Float64[np.ndarray, "m m"]]:
    """One matrix a degree from 1 on. Solved from samples: basis(R d) @ turned = basis(d) @ coefficients for all d."""
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
