"""Real spherical harmonics up to degree 3 inside compiled code, in the order and sign of 3DGS."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float32


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def sh_basis(x: np.float32, y: np.float32, z: np.float32, coefficients: int, basis: Float32[np.ndarray, "16"]) -> None:
    """Write the harmonics of the unit direction (x, y, z), eye to Gaussian, into the first places of `basis`.

    `coefficients` is 1, 4, 9 or 16. Constants as in 3DGS (Kerbl et al. 2023).
    """
    basis[0] = np.float32(0.28209479177387814)
    if coefficients > 1:
        basis[1] = np.float32(-0.4886025119029199) * y
        basis[2] = np.float32(0.4886025119029199) * z
        basis[3] = np.float32(-0.4886025119029199) * x
    if coefficients > 4:
        basis[4] = np.float32(1.0925484305920792) * x * y
        basis[5] = np.float32(-1.0925484305920792) * y * z
        basis[6] = np.float32(0.31539156525252005) * (np.float32(2) * z * z - x * x - y * y)
        basis[7] = np.float32(-1.0925484305920792) * x * z
        basis[8] = np.float32(0.5462742152960396) * (x * x - y * y)
    if coefficients > 9:
        basis[9] = np.float32(-0.5900435899266435) * y * (np.float32(3) * x * x - y * y)
        basis[10] = np.float32(2.890611442640554) * x * y * z
        basis[11] = np.float32(-0.4570457994644658) * y * (np.float32(4) * z * z - x * x - y * y)
        basis[12] = (
            np.float32(0.3731763325901154) * z * (np.float32(2) * z * z - np.float32(3) * x * x - np.float32(3) * y * y)
        )
        basis[13] = np.float32(-0.4570457994644658) * x * (np.float32(4) * z * z - x * x - y * y)
        basis[14] = np.float32(1.445305721320277) * z * (x * x - y * y)
        basis[15] = np.float32(-0.5900435899266435) * x * (x * x - np.float32(3) * y * y)


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check
def harmonics(directions: Float32[np.ndarray, "m 3"], coefficients: int) -> Float32[np.ndarray, "m k"]:
    """Evaluate the first 1, 4, 9 or 16 harmonics in unit directions, eye to Gaussian, in the object's own frame."""
    values = np.empty((len(directions), coefficients), np.float32)
    for chunk in numba.prange((len(directions) + 1023) // 1024):
        basis = np.empty(16, np.float32)
        for n in range(chunk * 1024, min(len(directions), (chunk + 1) * 1024)):
            sh_basis(directions[n, 0], directions[n, 1], directions[n, 2], coefficients, basis)
            values[n] = basis[:coefficients]
    return values
