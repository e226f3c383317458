"""Real spherical harmonics in float64 inside compiled code, and their derivative by direction; signed as in 3DGS."""

from typing import no_type_check

import numba

_C0 = 0.28209479177387814
_C1 = 0.4886025119029199
_C2, _C20, _C22 = 1.0925484305920792, 0.31539156525252005, 0.5462742152960396
_C33, _C32, _C31, _C30, _C3B = (
    0.5900435899266435,
    2.890611442640554,
    0.4570457994644658,
    0.3731763325901154,
    1.445305721320277,
)


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def harmonics_of(x, y, z, coefficients, basis):
    """Write the first 1, 4, 9 or 16 harmonics of the unit direction (x, y, z), eye to Gaussian, into `basis`."""
    basis[0] = _C0
    if coefficients > 1:
        basis[1], basis[2], basis[3] = -_C1 * y, _C1 * z, -_C1 * x
    if coefficients > 4:
        xx, yy, zz = x * x, y * y, z * z
        basis[4], basis[5], basis[7] = _C2 * x * y, -_C2 * y * z, -_C2 * x * z
        basis[6], basis[8] = _C20 * (2 * zz - xx - yy), _C22 * (xx - yy)
        if coefficients > 9:
            basis[9] = -_C33 * y * (3 * xx - yy)
            basis[10] = _C32 * x * y * z
            basis[11] = -_C31 * y * (4 * zz - xx - yy)
            basis[12] = _C30 * z * (2 * zz - 3 * xx - 3 * yy)
            basis[13] = -_C31 * x * (4 * zz - xx - yy)
            basis[14] = _C3B * z * (xx - yy)
            basis[15] = -_C33 * x * (xx - 3 * yy)


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def pulled_back(x, y, z, coefficients, g):
    """Gradient by the direction (x, y, z) of a loss whose gradient by the harmonics is `g`: three numbers."""
    gx = gy = gz = 0.0
    if coefficients > 1:
        gx, gy, gz = -_C1 * g[3], -_C1 * g[1], _C1 * g[2]
    if coefficients > 4:
        gx += _C2 * (y * g[4] - z * g[7]) - 2 * _C20 * x * g[6] + 2 * _C22 * x * g[8]
        gy += _C2 * (x * g[4] - z * g[5]) - 2 * _C20 * y * g[6] - 2 * _C22 * y * g[8]
        gz += -_C2 * (y * g[5] + x * g[7]) + 4 * _C20 * z * g[6]
        if coefficients > 9:
            xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
            gx += _C33 * (-6 * xy * g[9] - 3 * (xx - yy) * g[15]) + _C32 * yz * g[10]
            gx += _C31 * (2 * xy * g[11] - (4 * zz - 3 * xx - yy) * g[13])
            gx += -6 * _C30 * xz * g[12] + 2 * _C3B * xz * g[14]
            gy += _C33 * (-3 * (xx - yy) * g[9] + 6 * xy * g[15]) + _C32 * xz * g[10]
            gy += _C31 * (2 * xy * g[13] - (4 * zz - xx - 3 * yy) * g[11])
            gy += -6 * _C30 * yz * g[12] - 2 * _C3B * yz * g[14]
            gz += _C32 * xy * g[10] - 8 * _C31 * (yz * g[11] + xz * g[13])
            gz += 3 * _C30 * (2 * zz - xx - yy) * g[12] + _C3B * (xx - yy) * g[14]
    return gx, gy, gz
