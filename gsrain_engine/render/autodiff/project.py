"""Differentiable projection of Gaussians to splats in float32 or float64, and its backward pass."""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float, Float64

from ...kernels import kernel, range_of
from ...scene.camera import Camera
from ..cpu import projection
from ..cpu.projection import dot, in_camera, jacobian
from ..cpu.splats import CHUNK, DILATION_PX2, LOG_SCENE_CUT, NEAR_M, rotation_columns


class TrainedGaussians(NamedTuple):
    """Gaussians in the world (meters), all arrays in one precision; quaternions (wxyz) of any length above 0."""

    means: Float[np.ndarray, "n 3"]
    scales: Float[np.ndarray, "n 3"]
    quaternions: Float[np.ndarray, "n 4"]
    opacities: Float[np.ndarray, " n"]
    colors: Float[np.ndarray, "n k 3"]
    """Spherical harmonics (k = 1, 4, 9, 16); k = 0 if `display` is used."""
    display: Float[np.ndarray, "_ 3"]
    """Display colors, no rows if there are harmonics."""


class TrainedSplats(NamedTuple):
    """Content of `Splats`, a row for each Gaussian; rows with radius 0 are not drawn and undefined except for depth."""

    shapes: Float[np.ndarray, "n 8"]
    channels: Float[np.ndarray, "n 4"]
    """Display color, never negative, and depth along the view axis in meters, 0 where not drawn."""
    radii_px: Float[np.ndarray, " n"]
    """Three standard deviations of the longer axis."""


def project_trained(
    gaussians: TrainedGaussians, camera: Camera, world_to_camera: Float64[np.ndarray, "4 4"]
) -> TrainedSplats:
    """Project as `projection.project` does (EWA splatting as in 3DGS), a row for each Gaussian.

    Gaussians nearer than `NEAR_M`, outside the image, fainter than the scene's cut or not finite are not drawn.
    """
    n, dtype = len(gaussians.means), gaussians.means.dtype
    splats = TrainedSplats(np.empty((n, 8), dtype), np.empty((n, 4), dtype), np.empty(n, dtype))
    _project(*gaussians, world_to_camera, eye_of(world_to_camera), projection.intrinsics_of(camera), *splats)
    return splats


def eye_of(world_to_camera: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "3"]:
    """Camera position in the world; the matrix need not hold a pure rotation."""
    return np.linalg.solve(world_to_camera[:3, :3], -world_to_camera[:3, 3])


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _project(
    portion, means, scales, quaternions, opacities, colors, display, m, eye, intrinsics, shapes, channels, radii
):
    for chunk in range_of(portion, (len(means) + CHUNK - 1) // CHUNK):
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
def _unit(q):
    """Unit quaternion of one of any length, and 1 / length."""
    w, x, y, z = np.float64(q[0]), np.float64(q[1]), np.float64(q[2]), np.float64(q[3])
    by_length = 1 / np.sqrt(w * w + x * x + y * y + z * z)
    return w * by_length, x * by_length, y * by_length, z * by_length, by_length


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _shape(mean, scale, q, opacity, m, intrinsics, shape):
    """Write one splat's shape as in `Splats`; return its depth in m and radius in px, or 0 if it is not drawn.

    Scalars are float64 in either precision.
    """
    fx, fy, cx, cy, width, height = intrinsics
    px, py, pz = in_camera(m, mean)
    if not (NEAR_M < pz < 3e38):  # also rejects NaN
        return 0.0, 0.0
    u, v = fx * px / pz + cx, fy * py / pz + cy
    row_u, row_v, _, _, _, _ = jacobian(px, py, pz, m, intrinsics)
    w, x, y, z, _ = _unit(q)
    first, second, third = rotation_columns(w, x, y, z)
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
def _direction(mean, eye):
    """Unit vector from the eye to a mean, and 1 / distance."""
    x, y, z = mean[0] - eye[0], mean[1] - eye[1], mean[2] - eye[2]
    near = 1 / np.sqrt(x * x + y * y + z * z)
    return x * near, y * near, z * near, near


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _color(mean, sh, eye, basis):
    """Display color before clamping at 0: the sum of harmonics + 0.5."""
    x, y, z, _ = _direction(mean, eye)
    _write_sh_basis(x, y, z, len(sh), basis)
    red = green = blue = 0.5
    for k in range(len(sh)):
        red += basis[k] * sh[k, 0]
        green += basis[k] * sh[k, 1]
        blue += basis[k] * sh[k, 2]
    return red, green, blue


# Backward pass of projection


def project_backward(
    gaussians: TrainedGaussians,
    splats: TrainedSplats,
    sums: Float[np.ndarray, "n 10"],
    camera: Camera,
    world_to_camera: Float64[np.ndarray, "4 4"],
) -> tuple[TrainedGaussians, Float[np.ndarray, " n"], Float64[np.ndarray, "4 4"]]:
    """Convert the sums of `blend_backward` to a loss's gradients by the Gaussians and by `world_to_camera`.

    In between, the length of the gradient by each center in the image (px). Rows of Gaussians not drawn are zero.

    The chain of EWA splatting: shape -> 2D covariance -> Jacobian (which depends on the mean) and axes -> mean, scale,
    unnormalized quaternion, pose; and color -> harmonics -> view direction -> mean and eye.
    """
    found, on_screen = TrainedGaussians(*map(np.zeros_like, gaussians)), np.zeros_like(gaussians.opacities)
    eye = eye_of(world_to_camera)
    by_chunk = np.zeros((-(-len(gaussians.means) // CHUNK), 15))
    _project_back(
        *gaussians, *splats, sums, world_to_camera, eye, projection.intrinsics_of(camera), *found, on_screen, by_chunk
    )
    total = by_chunk.sum(axis=0)
    pose = np.zeros((4, 4))
    pose[:3] = total[:12].reshape(3, 4)
    # The eye satisfies R eye + t = 0: it moves by -R^-1 (dR eye + dt).
    by_eye = np.linalg.solve(world_to_camera[:3, :3].T, total[12:])
    pose[:3] -= np.outer(by_eye, np.append(eye, 1))
    return found, on_screen, pose


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _project_back(
    portion, means, scales, quaternions, opacities, colors, display, shapes, channels, radii, sums, m, eye, intrinsics,
    by_means, by_scales, by_quaternions, by_opacities, by_colors, by_display, on_screen, by_chunk,
):  # fmt: skip
    for chunk in range_of(portion, (len(means) + CHUNK - 1) // CHUNK):
        basis, by_basis = np.empty(16, np.float64), np.empty(16, np.float64)
        pose = by_chunk[chunk]
        for i in range(chunk * CHUNK, min(len(means), (chunk + 1) * CHUNK)):
            if radii[i] > 0:
                on_screen[i] = _shape_back(
                    means[i], scales[i], quaternions[i], m, intrinsics, shapes[i], sums[i], by_means[i], by_scales[i],
                    by_quaternions[i], pose,
                )  # fmt: skip
                by_opacities[i] = sums[i, 4] / opacities[i] if opacities[i] <= 1 else 0
                if len(display) > 0:
                    for c in range(3):
                        by_display[i, c] = sums[i, c] if channels[i, c] > 0 else 0
                else:
                    _color_back(
                        means[i], colors[i], channels[i], sums[i], eye, basis, by_basis, by_means[i], by_colors[i], pose
                    )


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _shape_back(mean, scale, q, m, intrinsics, shape, sums, by_mean, by_scale, by_q, pose):
    """Write gradients by mean, scale and quaternion, add that by the pose; return the length of that by the center."""
    fx, fy, _, _, _, _ = intrinsics
    px, py, pz = in_camera(m, mean)
    near = 1 / pz
    row_u, row_v, slope_x, slope_y, is_free_x, is_free_y = jacobian(px, py, pz, m, intrinsics)
    w, x, y, z, by_length = _unit(q)
    first, second, third = rotation_columns(w, x, y, z)
    a, b, c = np.float64(scale[0]), np.float64(scale[1]), np.float64(scale[2])
    u0, v0, u1, v1 = a * dot(row_u, first), a * dot(row_v, first), b * dot(row_u, second), b * dot(row_v, second)
    u2, v2 = c * dot(row_u, third), c * dot(row_v, third)

    # From the sums to center and covariance; sharpness_y is -1 / (2 (yy - xy^2 / xx)).
    shear, sharp_x, sharp_y = np.float64(shape[2]), np.float64(shape[3]), np.float64(shape[4])
    by_x, by_y = -2 * sharp_x * sums[5] + 2 * sharp_y * shear * sums[7], -2 * sharp_y * sums[7]
    by_shear = -2 * sharp_y * sums[8]
    by_yy = 2 * sharp_y * sharp_y * sums[9]
    by_xy = -2 * sharp_x * by_shear - 2 * shear * by_yy
    by_xx = 2 * sharp_x * sharp_x * sums[6] + shear * (2 * sharp_x * by_shear + shear * by_yy)

    gu0, gv0 = 2 * by_xx * u0 + by_xy * v0, 2 * by_yy * v0 + by_xy * u0
    gu1, gv1 = 2 * by_xx * u1 + by_xy * v1, 2 * by_yy * v1 + by_xy * u1
    gu2, gv2 = 2 * by_xx * u2 + by_xy * v2, 2 * by_yy * v2 + by_xy * u2
    gu = _combined(gu0 * a, first, gu1 * b, second, gu2 * c, third)
    gv = _combined(gv0 * a, first, gv1 * b, second, gv2 * c, third)
    g0 = gu0 * row_u[0] + gv0 * row_v[0], gu0 * row_u[1] + gv0 * row_v[1], gu0 * row_u[2] + gv0 * row_v[2]
    g1 = gu1 * row_u[0] + gv1 * row_v[0], gu1 * row_u[1] + gv1 * row_v[1], gu1 * row_u[2] + gv1 * row_v[2]
    g2 = gu2 * row_u[0] + gv2 * row_v[0], gu2 * row_u[1] + gv2 * row_v[1], gu2 * row_u[2] + gv2 * row_v[2]
    by_scale[0], by_scale[1], by_scale[2] = dot(g0, first), dot(g1, second), dot(g2, third)

    # The rotation's elements, row then column, to a quaternion of any length.
    g00, g10, g20 = a * g0[0], a * g0[1], a * g0[2]
    g01, g11, g21 = b * g1[0], b * g1[1], b * g1[2]
    g02, g12, g22 = c * g2[0], c * g2[1], c * g2[2]
    by_w = 2 * (z * (g10 - g01) + y * (g02 - g20) + x * (g21 - g12))
    by_i = 2 * (y * (g10 + g01) + z * (g20 + g02) - 2 * x * (g11 + g22) + w * (g21 - g12))
    by_j = 2 * (x * (g10 + g01) + z * (g21 + g12) - 2 * y * (g00 + g22) + w * (g02 - g20))
    by_k = 2 * (x * (g20 + g02) + y * (g21 + g12) - 2 * z * (g00 + g11) + w * (g10 - g01))
    along = by_w * w + by_i * x + by_j * y + by_k * z
    by_q[0], by_q[1] = by_length * (by_w - along * w), by_length * (by_i - along * x)
    by_q[2], by_q[3] = by_length * (by_j - along * y), by_length * (by_k - along * z)

    # From the rows of the Jacobian, row = near (f R_row - slope R_2), and the center to the mean in the camera's frame.
    by_slope_x = -near * (gu[0] * m[2, 0] + gu[1] * m[2, 1] + gu[2] * m[2, 2]) if is_free_x else 0.0
    by_slope_y = -near * (gv[0] * m[2, 0] + gv[1] * m[2, 1] + gv[2] * m[2, 2]) if is_free_y else 0.0
    across, down = fx * near * (by_x + by_slope_x), fy * near * (by_y + by_slope_y)
    by_z = sums[3] - near * (dot(gu, row_u) + dot(gv, row_v) + across * px + down * py)
    for k in range(3):
        by_mean[k] = m[0, k] * across + m[1, k] * down + m[2, k] * by_z
        pose[k] += across * mean[k] + near * fx * gu[k]
        pose[4 + k] += down * mean[k] + near * fy * gv[k]
        pose[8 + k] += by_z * mean[k] - near * (slope_x * gu[k] + slope_y * gv[k])
    pose[3] += across
    pose[7] += down
    pose[11] += by_z
    return np.sqrt(by_x * by_x + by_y * by_y)


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _combined(a, first, b, second, c, third):
    return (
        a * first[0] + b * second[0] + c * third[0],
        a * first[1] + b * second[1] + c * third[1],
        a * first[2] + b * second[2] + c * third[2],
    )


# Backward pass of colors


def sh_backward(
    gaussians: TrainedGaussians,
    splats: TrainedSplats,
    sums: Float[np.ndarray, "n 3"],
    world_to_camera: Float64[np.ndarray, "4 4"],
) -> tuple[Float[np.ndarray, "n k 3"], Float[np.ndarray, "_ 3"]]:
    """Convert the sums of `color_operator_transpose` to gradients of harmonics and display colors alone."""
    by_colors, by_display = np.zeros_like(gaussians.colors), np.zeros_like(gaussians.display)
    _colors_back(gaussians.means, *splats[1:], sums, eye_of(world_to_camera), by_colors, by_display)
    return by_colors, by_display


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _colors_back(portion, means, channels, radii, sums, eye, by_colors, by_display):
    for chunk in range_of(portion, (len(means) + CHUNK - 1) // CHUNK):
        basis = np.empty(16, np.float64)
        for i in range(chunk * CHUNK, min(len(means), (chunk + 1) * CHUNK)):
            if radii[i] > 0:
                if len(by_display) > 0:
                    for c in range(3):
                        by_display[i, c] = sums[i, c] if channels[i, c] > 0 else 0
                else:
                    _harmonics_back(means[i], channels[i], sums[i], eye, basis, by_colors[i])


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _harmonics_back(mean, channels, sums, eye, basis, by_sh):
    """Write the gradient by the harmonics; returns that by the color before clamping, and the view direction."""
    x, y, z, near = _direction(mean, eye)
    _write_sh_basis(x, y, z, len(by_sh), basis)
    red = np.float64(sums[0]) if channels[0] > 0 else 0.0  # clamped channels have no gradient
    green = np.float64(sums[1]) if channels[1] > 0 else 0.0
    blue = np.float64(sums[2]) if channels[2] > 0 else 0.0
    for k in range(len(by_sh)):
        by_sh[k, 0], by_sh[k, 1], by_sh[k, 2] = basis[k] * red, basis[k] * green, basis[k] * blue
    return red, green, blue, x, y, z, near


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _color_back(mean, sh, channels, sums, eye, basis, by_basis, by_mean, by_sh, pose):
    """Write the gradient by the harmonics; add those by the mean and, in the last three numbers of `pose`, the eye."""
    red, green, blue, x, y, z, near = _harmonics_back(mean, channels, sums, eye, basis, by_sh)
    for k in range(len(sh)):
        by_basis[k] = red * sh[k, 0] + green * sh[k, 1] + blue * sh[k, 2]
    gx, gy, gz = _direction_back(x, y, z, len(sh), by_basis)
    along = gx * x + gy * y + gz * z
    by_direction = near * (gx - along * x), near * (gy - along * y), near * (gz - along * z)
    for k in range(3):
        by_mean[k] += by_direction[k]
        pose[12 + k] -= by_direction[k]


# Spherical harmonics and their derivative
# Float64, with 3DGS signs.

_C0, _C1 = 0.28209479177387814, 0.4886025119029199
_C2, _C20, _C22 = 1.0925484305920792, 0.31539156525252005, 0.5462742152960396
_C33, _C32, _C31 = 0.5900435899266435, 2.890611442640554, 0.4570457994644658
_C30, _C3B = 0.3731763325901154, 1.445305721320277


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _write_sh_basis(x, y, z, coefficients, basis):
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
def _direction_back(x, y, z, coefficients, g):
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
