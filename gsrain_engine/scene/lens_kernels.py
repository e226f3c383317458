"""Kernels of lenses and rolling shutters: points to places in the picture and back, by numbers of `lens_numbers`."""

from typing import no_type_check

import numba
import numpy as np

from ..kernels import kernel, range_of

_NEWTON_STEPS, _BRACKET_STEPS = 12, 60
_LARGEST_ERROR_PX, _CLOSE_PX = 0.01, 1e-7
_STEP = 1e-6  # of a derivative
_CHUNK = 1024


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def polynomial_of(angle, lens):
    """Length of the place of an angle from the axis."""
    length = lens[18]
    for k in range(17, 3, -1):
        length = lens[k] + angle * length
    return length * angle


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def straight_place(x, y, z, lens):
    """Place without shear, see `bent_place`."""
    if lens[0] == 0:
        return x / z, y / z, z > 0
    if lens[0] == 1:
        a, b = x / z, y / z
        r2 = a * a + b * b
        above = 1 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]))
        radial = above / (1 + r2 * (lens[9] + r2 * (lens[10] + r2 * lens[11])))
        p = a * radial + 2 * lens[6] * a * b + lens[7] * (r2 + 2 * a * a) + r2 * (lens[12] + r2 * lens[13])
        q = b * radial + lens[6] * (r2 + 2 * b * b) + 2 * lens[7] * a * b + r2 * (lens[14] + r2 * lens[15])
        return p, q, z > 0 and r2 <= lens[1] * lens[1]
    r = np.sqrt(x * x + y * y)
    angle = np.arctan2(r, z)
    scale = polynomial_of(angle, lens) / r if r > 1e-9 * abs(z) else lens[4] / abs(z)
    return x * scale, y * scale, angle <= lens[1]


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def bent_place(x, y, z, lens):
    """Place in the picture, over the focal length, of a point in the camera's frame, and whether the lens images it."""
    p, q, is_imaged = straight_place(x, y, z, lens)
    return p + lens[2] * q, q + lens[3] * p, is_imaged


@kernel(error_model="numpy")
@no_type_check
def bend_points(points, lens, places, is_imaged):
    for i in range(len(points)):
        places[i, 0], places[i, 1], is_imaged[i] = bent_place(points[i, 0], points[i, 1], points[i, 2], lens)


@kernel(parallel=True, error_model="numpy")
@no_type_check
def unbend_places(portion, places, lens, fx, fy, rays, is_imaged):
    for chunk in range_of(portion, (len(places) + _CHUNK - 1) // _CHUNK):
        for i in range(chunk * _CHUNK, min(len(places), (chunk + 1) * _CHUNK)):
            shear = 1 / (1 - lens[2] * lens[3])
            p = shear * (places[i, 0] - lens[2] * places[i, 1])
            q = shear * (places[i, 1] - lens[3] * places[i, 0])
            if lens[0] == 1:
                x, y, z, found = _by_tangent(p, q, lens, fx, fy)
            else:
                x, y, z, found = _by_angle(p, q, lens, max(fx, fy))
            is_imaged[i] = found
            rays[i, 0], rays[i, 1], rays[i, 2] = (x, y, z) if found else (0.0, 0.0, 1.0)


@numba.njit(error_model="numpy")
@no_type_check
def _by_tangent(p, q, lens, fx, fy):
    """Ray of a place by OpenCV's distortion, by Newton's method, and whether there is one."""
    a, b, area = p, q, 1.0
    error_a = error_b = np.inf
    for _ in range(_NEWTON_STEPS + 1):
        at_a, at_b, _ = straight_place(a, b, 1.0, lens)
        error_a, error_b = at_a - p, at_b - q
        to_a, to_b, _ = straight_place(a + _STEP, b, 1.0, lens)
        by_aa, by_ab = (to_a - at_a) / _STEP, (to_b - at_b) / _STEP
        to_a, to_b, _ = straight_place(a, b + _STEP, 1.0, lens)
        by_ba, by_bb = (to_a - at_a) / _STEP, (to_b - at_b) / _STEP
        area = by_aa * by_bb - by_ab * by_ba
        if max(abs(error_a) * fx, abs(error_b) * fy) < _CLOSE_PX or area == 0:
            break
        a, b = a - (by_bb * error_a - by_ba * error_b) / area, b - (by_aa * error_b - by_ab * error_a) / area
    # Beyond the lens's range the polynomial falls: a mirrored image, which no lens has.
    found = max(abs(error_a) * fx, abs(error_b) * fy) < _LARGEST_ERROR_PX and area > 0
    length = np.sqrt(a * a + b * b + 1)
    return a / length, b / length, 1 / length, found and a * a + b * b <= lens[1] * lens[1]


@numba.njit(error_model="numpy")
@no_type_check
def _by_angle(p, q, lens, focal):
    """Ray of a place by a polynomial of the angle, which rises up to its limit, and whether there is one."""
    length = np.sqrt(p * p + q * q)
    low, high, angle = 0.0, lens[1], min(length / lens[4], lens[1])
    if polynomial_of(high, lens) < length:
        return 0.0, 0.0, 1.0, False
    for _ in range(_BRACKET_STEPS):  # Newton's method, or the middle of the bracket where that leaves it
        error = polynomial_of(angle, lens) - length
        if abs(error) * focal < _CLOSE_PX:
            break
        low, high = (low, angle) if error > 0 else (angle, high)
        slope = (polynomial_of(angle + _STEP, lens) - polynomial_of(angle, lens)) / _STEP
        angle = angle - error / slope
        if not low <= angle <= high:
            angle = 0.5 * (low + high)
    scale = np.sin(angle) / length if length > 0 else 0.0
    return scale * p, scale * q, np.cos(angle), True


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def turned_back(x, y, z, part, turn):
    """Point in the frame of a camera that has turned by a part of a rotation vector."""
    wx, wy, wz = -part * turn[0], -part * turn[1], -part * turn[2]
    square = wx * wx + wy * wy + wz * wz
    if square < 1e-16:
        return x, y, z
    angle = np.sqrt(square)
    first, second = np.sin(angle) / angle, (1 - np.cos(angle)) / square
    cx, cy, cz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
    dx, dy, dz = wy * cz - wz * cy, wz * cx - wx * cz, wx * cy - wy * cx
    return x + first * cx + second * dx, y + first * cy + second * dy, z + first * cz + second * dz
