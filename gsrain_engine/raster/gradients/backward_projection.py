"""The derivative of projection: from what a loss asks of splats to what it asks of Gaussians and of the pose."""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float, Float64

from gsrain_engine.scene.camera import Camera

from .backward_colors import color_back
from .forward_projection import (
    CHUNK,
    TrainedGaussians,
    TrainedSplats,
    dot,
    eye_of,
    intrinsics_of,
    jacobian,
    moved,
    rotation,
)


class GaussianGradients(NamedTuple):
    """A loss's gradient by each array of `TrainedGaussians`; zero rows for what is not drawn."""

    means: Float[np.ndarray, "n 3"]
    scales: Float[np.ndarray, "n 3"]
    quaternions: Float[np.ndarray, "n 4"]
    opacities: Float[np.ndarray, " n"]
    colors: Float[np.ndarray, "n k 3"]
    display: Float[np.ndarray, "_ 3"]
    on_screen: Float[np.ndarray, " n"]
    """Length of the gradient by the centre in the image (px)."""


def project_back(
    gaussians: TrainedGaussians,
    splats: TrainedSplats,
    sums: Float[np.ndarray, "n 10"],
    camera: Camera,
    world_to_camera: Float64[np.ndarray, "4 4"],
) -> tuple[GaussianGradients, Float64[np.ndarray, "4 4"]]:
    """Take the sums of `backward_blending.gather` to the Gaussians and to the elements of `world_to_camera`.

    The chain of EWA splatting: shape -> 2D covariance -> Jacobian (which depends on the mean) and axes -> mean, scale,
    quaternion before it was made a unit one, pose; and colour -> harmonics -> direction of view -> mean and eye.
    """
    arrays = GaussianGradients(*map(np.zeros_like, [*gaussians, gaussians.opacities]))
    eye = eye_of(world_to_camera)
    by_chunk = np.zeros((-(-len(gaussians.means) // CHUNK), 15))
    _project_back(*gaussians, *splats, sums, world_to_camera, eye, intrinsics_of(camera), *arrays, by_chunk)
    total = by_chunk.sum(axis=0)
    pose = np.zeros((4, 4))
    pose[:3] = total[:12].reshape(3, 4)
    # The eye is where R eye + t = 0: it moves by -R^-1 (dR eye + dt).
    pull = np.linalg.solve(world_to_camera[:3, :3].T, total[12:])
    pose[:3] -= np.outer(pull, np.append(eye, 1))
    return arrays, pose


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check
def _project_back(
    means, scales, quaternions, opacities, colors, display, shapes, channels, radii, sums, m, eye, intrinsics,
    by_means, by_scales, by_quaternions, by_opacities, by_colors, by_display, on_screen, by_chunk,
):  # fmt: skip
    for chunk in numba.prange((len(means) + CHUNK - 1) // CHUNK):
        basis, by_basis = np.empty(16, np.float64), np.empty(16, np.float64)
        pose = by_chunk[chunk]
        for i in range(chunk * CHUNK, min(len(means), (chunk + 1) * CHUNK)):
            if radii[i] > 0:
                length = _shape_back(
                    means[i], scales[i], quaternions[i], m, intrinsics, shapes[i], sums[i], by_means[i], by_scales[i],
                    by_quaternions[i], pose,
                )  # fmt: skip
                on_screen[i] = length
                by_opacities[i] = sums[i, 4] / opacities[i] if opacities[i] <= 1 else 0
                if len(display) > 0:
                    for c in range(3):
                        by_display[i, c] = sums[i, c] if channels[i, c] > 0 else 0
                else:
                    color_back(
                        means[i], colors[i], channels[i], sums[i], eye, basis, by_basis, by_means[i], by_colors[i], pose
                    )


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _shape_back(mean, scale, q, m, intrinsics, shape, sums, by_mean, by_scale, by_q, pose):
    """Write gradients by mean, scale and quaternion, add that by the pose; return the length of that by the centre."""
    fx, fy, _, _, _, _ = intrinsics
    px, py, pz = moved(m, 0, mean), moved(m, 1, mean), moved(m, 2, mean)
    near = 1 / pz
    row_u, row_v, slope_x, slope_y, is_free_x, is_free_y = jacobian(px, py, pz, m, intrinsics)
    first, second, third, unit, by_length = rotation(q)
    a, b, c = np.float64(scale[0]), np.float64(scale[1]), np.float64(scale[2])
    u0, v0, u1, v1 = a * dot(row_u, first), a * dot(row_v, first), b * dot(row_u, second), b * dot(row_v, second)
    u2, v2 = c * dot(row_u, third), c * dot(row_v, third)

    # From the sums to centre and covariance; sharpness_y is -1 / (2 (yy - xy^2 / xx)).
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
    _quaternion_back(unit, by_length, a, g0, b, g1, c, g2, by_q)

    # From the rows of the Jacobian, row = near (f R_row - slope R_2), and the centre to the mean before the camera.
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
    """Sum of three triples, each with its factor."""
    return (
        a * first[0] + b * second[0] + c * third[0],
        a * first[1] + b * second[1] + c * third[1],
        a * first[2] + b * second[2] + c * third[2],
    )


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _quaternion_back(unit, by_length, a, g0, b, g1, c, g2, by_q):
    """Write the gradient by a quaternion of any length from those by its three scaled axes."""
    w, x, y, z = unit
    g00, g10, g20 = a * g0[0], a * g0[1], a * g0[2]  # by the rotation's elements, row then column
    g01, g11, g21 = b * g1[0], b * g1[1], b * g1[2]
    g02, g12, g22 = c * g2[0], c * g2[1], c * g2[2]
    by_w = 2 * (z * (g10 - g01) + y * (g02 - g20) + x * (g21 - g12))
    by_x = 2 * (y * (g10 + g01) + z * (g20 + g02) - 2 * x * (g11 + g22) + w * (g21 - g12))
    by_y = 2 * (x * (g10 + g01) + z * (g21 + g12) - 2 * y * (g00 + g22) + w * (g02 - g20))
    by_z = 2 * (x * (g20 + g02) + y * (g21 + g12) - 2 * z * (g00 + g11) + w * (g10 - g01))
    along = by_w * w + by_x * x + by_y * y + by_z * z
    by_q[0], by_q[1] = by_length * (by_w - along * w), by_length * (by_x - along * x)
    by_q[2], by_q[3] = by_length * (by_y - along * y), by_length * (by_z - along * z)
