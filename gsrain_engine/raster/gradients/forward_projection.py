"""Trained Gaussians -> splats, in float32 or float64: the part of `projection` that has a derivative."""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float, Float64

from gsrain_engine.scene.camera import Camera

from ..projection import DILATION_PX2, NEAR_M
from ..splats import LOG_SCENE_CUT
from .harmonics_derivative import harmonics_of

CHUNK = 512
"""Gaussians that one thread takes at a time."""


class TrainedGaussians(NamedTuple):
    """Gaussians in the world (metres), all arrays in one precision; quaternions (wxyz) of any length above 0."""

    means: Float[np.ndarray, "n 3"]
    scales: Float[np.ndarray, "n 3"]
    quaternions: Float[np.ndarray, "n 4"]
    opacities: Float[np.ndarray, " n"]
    colors: Float[np.ndarray, "n k 3"]
    """Spherical harmonics (k = 1, 4, 9, 16); k = 0 stands for display colours in `display`."""
    display: Float[np.ndarray, "_ 3"]
    """Display colours where there are no harmonics, else no rows."""


class TrainedSplats(NamedTuple):
    """What `Splats` holds, a row for each Gaussian; rows with radius 0 are not drawn and hold anything but a depth."""

    shapes: Float[np.ndarray, "n 8"]
    channels: Float[np.ndarray, "n 4"]
    """Display colour, never negative, and depth along the view axis in metres, 0 where not drawn."""
    radii_px: Float[np.ndarray, " n"]
    """Three standard deviations of the longer axis."""


def project_trained(
    gaussians: TrainedGaussians, camera: Camera, world_to_camera: Float64[np.ndarray, "4 4"]
) -> TrainedSplats:
    """Project as `projection.project` does (EWA splatting as in 3DGS), a row for each Gaussian.

    What is nearer than `NEAR_M`, outside the image, fainter than the scene's cut or not finite is not drawn.
    """
    n, dtype = len(gaussians.means), gaussians.means.dtype
    splats = TrainedSplats(np.empty((n, 8), dtype), np.empty((n, 4), dtype), np.empty(n, dtype))
    _project(*gaussians, world_to_camera, eye_of(world_to_camera), intrinsics_of(camera), *splats)
    return splats


def eye_of(world_to_camera: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "3"]:
    """Where the camera stands in the world; the matrix need not hold a pure rotation."""
    return np.linalg.solve(world_to_camera[:3, :3], -world_to_camera[:3, 3])


def intrinsics_of(camera: Camera) -> tuple[float, float, float, float, float, float]:
    """Focal lengths, principal point and size in pixels, for compiled code."""
    c = camera
    return float(c.fx), float(c.fy), float(c.cx), float(c.cy), float(c.width), float(c.height)


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check
def _project(means, scales, quaternions, opacities, colors, display, m, eye, intrinsics, shapes, channels, radii):
    for chunk in numba.prange((len(means) + CHUNK - 1) // CHUNK):
        basis = np.empty(16, np.float64)
        for i in range(chunk * CHUNK, min(len(means), (chunk + 1) * CHUNK)):
            depth, radius = _shape(means[i], scales[i], quaternions[i], opacities[i], m, intrinsics, shapes[i])
            if depth > 0:
                if len(display) > 0:
                    red, green, blue = np.float64(display[i, 0]), np.float64(display[i, 1]), np.float64(display[i, 2])
                else:
                    red, green, blue = _color(means[i], colors[i], eye, basis)
                channels[i, 0], channels[i, 1], channels[i, 2] = max(red, 0.0), max(green, 0.0), max(blue, 0.0)
                if not (np.isfinite(red) and np.isfinite(green) and np.isfinite(blue)):
                    depth, radius = 0.0, 0.0
            channels[i, 3] = depth
            radii[i] = radius


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def jacobian(px, py, pz, m, intrinsics):
    """The two rows that take the world's axes to pixels, the slopes they were made with, and if those are free.

    Slopes are held back at 1.3 times the field of view: there they no longer depend on the mean.
    """
    fx, fy, cx, cy, width, height = intrinsics
    near = 1 / pz
    margin_x, margin_y = 0.15 * width, 0.15 * height
    across, down = fx * px * near, fy * py * near
    slope_x = min(max(across, -cx - margin_x), width - cx + margin_x)
    slope_y = min(max(down, -cy - margin_y), height - cy + margin_y)
    ux, vx = near * (fx * m[0, 0] - slope_x * m[2, 0]), near * (fy * m[1, 0] - slope_y * m[2, 0])
    uy, vy = near * (fx * m[0, 1] - slope_x * m[2, 1]), near * (fy * m[1, 1] - slope_y * m[2, 1])
    uz, vz = near * (fx * m[0, 2] - slope_x * m[2, 2]), near * (fy * m[1, 2] - slope_y * m[2, 2])
    return (ux, uy, uz), (vx, vy, vz), slope_x, slope_y, slope_x == across, slope_y == down


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def rotation(q):
    """Columns of the rotation of a quaternion of any length, its unit quaternion and 1 / length."""
    w, x, y, z = np.float64(q[0]), np.float64(q[1]), np.float64(q[2]), np.float64(q[3])
    by_length = 1 / np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * by_length, x * by_length, y * by_length, z * by_length
    first = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
    second = 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)
    third = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
    return first, second, third, (w, x, y, z), by_length


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def dot(a, b):
    """Scalar product of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def moved(m, row, mean):
    """One coordinate of a mean before the camera."""
    return m[row, 0] * mean[0] + m[row, 1] * mean[1] + m[row, 2] * mean[2] + m[row, 3]


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _shape(mean, scale, q, opacity, m, intrinsics, shape):
    """Write one splat's shape as in `Splats`; return its depth in m and radius in px, or 0 where it is not drawn.

    Scalars are float64 in either precision.
    """
    fx, fy, cx, cy, width, height = intrinsics
    pz = moved(m, 2, mean)
    if not (NEAR_M < pz < 3e38):  # also drops NaN
        return 0.0, 0.0
    px, py = moved(m, 0, mean), moved(m, 1, mean)
    u, v = fx * px / pz + cx, fy * py / pz + cy
    row_u, row_v, _, _, _, _ = jacobian(px, py, pz, m, intrinsics)
    first, second, third, _, _ = rotation(q)
    a, b, c = np.float64(scale[0]), np.float64(scale[1]), np.float64(scale[2])
    u0, v0 = a * dot(row_u, first), a * dot(row_v, first)
    u1, v1 = b * dot(row_u, second), b * dot(row_v, second)
    u2, v2 = c * dot(row_u, third), c * dot(row_v, third)
    xx = u0 * u0 + u1 * u1 + u2 * u2 + DILATION_PX2
    yy = v0 * v0 + v1 * v1 + v2 * v2 + DILATION_PX2
    xy = u0 * v0 + u1 * v1 + u2 * v2
    determinant = xx * yy - xy * xy
    if not (0 < determinant < np.inf):
        return 0.0, 0.0
    log_alpha = np.log(min(np.float64(opacity), 1.0))
    if not (log_alpha > LOG_SCENE_CUT and opacity < np.inf):
        return 0.0, 0.0
    extent = np.sqrt(2 * (log_alpha - LOG_SCENE_CUT))  # exact: alpha is the cut at the edge
    reach_x, reach_y = extent * np.sqrt(xx), extent * np.sqrt(yy)
    if not (u + reach_x > 0 and u - reach_x < width and v + reach_y > 0 and v - reach_y < height):
        return 0.0, 0.0
    shape[0], shape[1] = u, v
    shape[2] = xy / xx
    shape[3] = -0.5 / xx
    shape[4] = -0.5 * xx / determinant
    shape[5], shape[6] = log_alpha, LOG_SCENE_CUT
    shape[7] = reach_x
    middle, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
    return pz, 3 * np.sqrt(middle + np.sqrt(half * half + xy * xy))


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def direction(mean, eye):
    """Unit vector from the eye to a mean, and 1 / distance."""
    x, y, z = mean[0] - eye[0], mean[1] - eye[1], mean[2] - eye[2]
    near = 1 / np.sqrt(x * x + y * y + z * z)
    return x * near, y * near, z * near, near


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _color(mean, sh, eye, basis):
    """Display colour before it is cut at 0: the sum of harmonics + 0.5."""
    x, y, z, _ = direction(mean, eye)
    harmonics_of(x, y, z, len(sh), basis)
    red = green = blue = 0.5
    for k in range(len(sh)):
        red += basis[k] * sh[k, 0]
        green += basis[k] * sh[k, 1]
        blue += basis[k] * sh[k, 2]
    return red, green, blue
