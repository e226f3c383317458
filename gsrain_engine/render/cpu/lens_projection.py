"""Projection of Gaussians through lenses and rolling shutters by the unscented transform (3DGUT, Wu et al. 2025).

The mean and points on the axes of a Gaussian, seven sigma points, are projected each by the lens and from the pose of
its own row; mean and covariance of their pixels are those of the splat (Julier and Uhlmann 1997; alpha 1, beta 2, kappa
0). That holds for Gaussians that are small from where the camera is. A larger one is shrunk before, and its splat
enlarged by as much, which goes over into the affine map of 3DGS: ground that reaches below the camera has no mean.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float64, Int64

from ...kernels import kernel, range_of
from ...scene.camera import Camera
from ...scene.lens import lens_numbers, view_bounds
from ...scene.lens_kernels import bent_place
from ...scene.rolling_shutter import readout_of
from ...scene.scene import DrawItem
from .splats import (
    CHUNK,
    LOG_RAIN_CUT,
    NEAR_M,
    RAIN_ALPHA_CUT,
    direction_to,
    eye_in_object,
    has_bit,
    mask_words,
    rotation_columns,
    write_colors,
    write_shape,
)

_SPREAD = float(np.sqrt(3.0))  # distance of sigma points from the mean, in standard deviations
_WIDEST = 0.25  # distance of sigma points over that of the camera, to which Gaussians are shrunk
_LOCAL = 0.01  # the same where the lens does not image all of them
_MARGIN = 0.15  # of the picture, around it, beyond which shapes are those at its end, as in gsplat
_ROW_STEPS = 5
_MAX_PART = 1.0  # of the readout, beyond the picture's first and last row


class LensView(NamedTuple):
    """A camera with a lens or a rolling shutter, for kernels."""

    intrinsics: tuple[float, float, float, float, float, float]
    lens: Float64[np.ndarray, "19"]
    scan: Float64[np.ndarray, "3"]
    """Part of the readout of a place over the focal length (x, y, 1)."""
    by_distance: bool
    """True if depth is the distance from the camera, false if it is that along the axis."""
    largest_angle: float
    """Of the view from the axis."""
    edges: tuple[float, float, float, float]
    """Lowest and highest x/z, lowest and highest y/z at which shapes are evaluated; by angle there are none."""


def lens_view(camera: Camera) -> LensView:
    """Numbers of a camera for kernels."""
    c = camera
    intrinsics = float(c.fx), float(c.fy), float(c.cx), float(c.cy), float(c.width), float(c.height)
    scan = np.zeros(3)
    if c.rolling is not None:
        scan[:] = readout_of(c, c.rolling.readout_s, c.rolling.direction)[1:]
    bounds, lens, edges = view_bounds(c), lens_numbers(c.lens), (-np.inf, np.inf, -np.inf, np.inf)
    if bounds.slopes is not None and lens[0] < 2:
        left, right, top, bottom = bounds.slopes.tolist()
        wide, high = _MARGIN * (right - left), _MARGIN * (bottom - top)
        edges = left - wide, right + wide, top - high, bottom + high
    return LensView(intrinsics, lens, scan, c.lens is not None, bounds.angle_rad, edges)


class RollingPose(NamedTuple):
    """Pose of Gaussians over a readout, as a polynomial of its part s: exact at -1/2, 0 and 1/2."""

    matrices: Float64[np.ndarray, "3 4 4"]
    """Object to camera: matrices[0] + s matrices[1] + s^2 matrices[2]."""
    eyes: Float64[np.ndarray, "3 3"]
    """Center of projection in the object's frame, in the same form."""
    moves: bool
    slack_m: float = 0.0
    """Distance by which points may be away from their place in the middle, but for turns of the camera."""


def rolling_pose(part: DrawItem, camera: Camera, *, is_held: bool = False) -> RollingPose:
    """Pose of a part over the readout of a camera; `is_held` is the pose in the middle, at all rows."""
    middle, eye = camera.world_to_camera @ part.to_world, eye_in_object(camera, part)
    matrices, eyes = np.zeros((3, 4, 4)), np.zeros((3, 3))
    matrices[0], eyes[0] = middle, eye
    if camera.rolling is None or is_held:
        return RollingPose(matrices, eyes, moves=False)
    places = part.to_world_ends or (part.to_world, part.to_world)
    ends = [part._replace(to_world=place) for place in places]
    cameras = [camera.at_readout(-0.5), camera.at_readout(0.5)]
    first, last = (at.world_to_camera @ end.to_world for at, end in zip(cameras, ends, strict=True))
    matrices[1], matrices[2] = last - first, 2 * (first + last - 2 * middle)
    first, last = (eye_in_object(at, end) for at, end in zip(cameras, ends, strict=True))
    eyes[1], eyes[2] = last - first, 2 * (first + last - 2 * eye)
    moved = max(float(np.linalg.norm((place - part.to_world)[:3, 3])) for place in places)
    slack_m = float(np.linalg.norm(camera.rolling.shift_m)) + 1.5 * moved
    return RollingPose(matrices, eyes, bool(np.any(matrices[1:])), slack_m)


def lens_candidates(part: DrawItem, pose: RollingPose, view: LensView, *, as_points: bool) -> Int64[np.ndarray, " m"]:
    """Indices of a part's possibly visible Gaussians."""
    if part.members is not None:
        return part.members if part.opacity > 0 else part.members[:0]
    g, n = part.gaussians, part.drawn_count if part.opacity > 0 else 0
    flags = np.empty(n, np.bool_)
    largest = part.growth * np.cbrt(abs(np.linalg.det(pose.matrices[0, :3, :3])))
    faintest = -np.inf if as_points or n == 0 else RAIN_ALPHA_CUT / part.opacity
    _flag_in_cone(
        g.means[:n], g.scales[:n], g.opacities[:n], mask_words(part.left_out), faintest, pose.matrices[0], largest,
        view.largest_angle, pose.slack_m, flags,
    )  # fmt: skip
    return np.flatnonzero(flags)


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _flag_in_cone(portion, means, scales, opacities, left_out, faintest, m, scale, angle, slack, flags):
    """Flag Gaussians that reach into the cone of the view, each treated as a ball."""
    extent = np.sqrt(-2 * LOG_RAIN_CUT) * scale
    inner, ahead_sine, ahead_cosine = angle + 0.02, np.sin(min(angle + 0.02, np.pi)), np.cos(min(angle + 0.02, np.pi))
    for chunk in range_of(portion, (len(flags) + CHUNK - 1) // CHUNK):
        for i in range(chunk * CHUNK, min(len(flags), (chunk + 1) * CHUNK)):
            x = m[0, 0] * means[i, 0] + m[0, 1] * means[i, 1] + m[0, 2] * means[i, 2] + m[0, 3]
            y = m[1, 0] * means[i, 0] + m[1, 1] * means[i, 1] + m[1, 2] * means[i, 2] + m[1, 3]
            z = m[2, 0] * means[i, 0] + m[2, 1] * means[i, 1] + m[2, 2] * means[i, 2] + m[2, 3]
            reach = extent * max(scales[i, 0], scales[i, 1], scales[i, 2]) + slack
            across = np.sqrt(x * x + y * y)
            # Distance from the cone's side, where that is the nearest point of it.
            outside = across * ahead_cosine - z * ahead_sine
            near = inner >= np.pi or outside <= reach or x * x + y * y + z * z <= reach * reach
            flags[i] = near and opacities[i] > faintest and not (len(left_out) > 0 and has_bit(left_out, i))


@kernel(parallel=True, error_model="numpy")
@no_type_check
def project_through_lens(
    portion, members, means, scales, quaternions, opacities, sh, wet_sh, wetness, rain, opacity, change, selected,
    as_points, antialiased, matrices, eyes, moves, intrinsics, lens, scan, by_distance, edges, shapes, colors, points,
):  # fmt: skip
    """Fill shapes, colors and points (in the camera's frame) of one part; depth 0 marks those not to be drawn."""
    for chunk in range_of(portion, (len(members) + CHUNK - 1) // CHUNK):
        first, last = chunk * CHUNK, min(len(members), (chunk + 1) * CHUNK)
        directions, eye = np.zeros((CHUNK, 3), np.float32), eyes[0].copy()
        for n in range(first, last):
            i = members[n]
            is_rain = len(rain) > 0 and rain[i]
            depth = _shape(
                means[i], scales[i], quaternions[i], opacity * opacities[i], is_rain, as_points, antialiased,
                matrices, moves, intrinsics, lens, scan, by_distance, edges, shapes[n], points[n],
            )  # fmt: skip
            colors[n, 3] = depth
            if not depth > 0:
                shapes[n, :] = 0
                colors[n, :] = 0
                continue
            if moves:
                u, v = (shapes[n, 0] - intrinsics[2]) / intrinsics[0], (shapes[n, 1] - intrinsics[3]) / intrinsics[1]
                part = min(max(scan[0] * u + scan[1] * v + scan[2], -_MAX_PART), _MAX_PART)
                for k in range(3):
                    eye[k] = eyes[0, k] + part * (eyes[1, k] + part * eyes[2, k])
            mean = means[i, 0], means[i, 1], means[i, 2]
            directions[n - first, 0], directions[n - first, 1], directions[n - first, 2] = direction_to(mean, eye)
        write_colors(first, last, members, directions, sh, wet_sh, wetness, change, selected, shapes, colors)
        for n in range(first, last):
            if not colors[n, 3] > 0:
                points[n, :] = 0


@numba.njit(error_model="numpy")
@no_type_check
def _pixel(x, y, z, aside, matrices, moves, intrinsics, lens, scan):
    """Pixel of a point of an object and the point in the camera's frame, at the time of its row; and if it is imaged.

    It is moved `aside` in the camera's frame.

    The part of the readout is a fixed point: a row's time tells where the point is, and that its row.
    """
    m = matrices[0]
    px = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3] + aside[0]
    py = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3] + aside[1]
    pz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
    a, b, is_imaged = bent_place(px, py, pz, lens)
    if moves:
        d, e = matrices[1], matrices[2]
        dx = d[0, 0] * x + d[0, 1] * y + d[0, 2] * z + d[0, 3]
        dy = d[1, 0] * x + d[1, 1] * y + d[1, 2] * z + d[1, 3]
        dz = d[2, 0] * x + d[2, 1] * y + d[2, 2] * z + d[2, 3]
        ex = e[0, 0] * x + e[0, 1] * y + e[0, 2] * z + e[0, 3]
        ey = e[1, 0] * x + e[1, 1] * y + e[1, 2] * z + e[1, 3]
        ez = e[2, 0] * x + e[2, 1] * y + e[2, 2] * z + e[2, 3]
        qx, qy, qz, part = px, py, pz, 0.0
        for _ in range(_ROW_STEPS):
            if not is_imaged:
                break
            part = min(max(scan[0] * a + scan[1] * b + scan[2], -_MAX_PART), _MAX_PART)
            px, py, pz = qx + part * (dx + part * ex), qy + part * (dy + part * ey), qz + part * (dz + part * ez)
            a, b, is_imaged = bent_place(px, py, pz, lens)
    return intrinsics[0] * a + intrinsics[2], intrinsics[1] * b + intrinsics[3], px, py, pz, is_imaged


@numba.njit(error_model="numpy")
@no_type_check
def _shape(
    mean, scale, q, opacity, is_rain, as_point, antialiased, matrices, moves, intrinsics, lens, scan, by_distance,
    edges, shape, point,
):  # fmt: skip
    """Write one splat's shape and its point; return its depth in meters, or 0 if it is not to be drawn."""
    width, height = intrinsics[4], intrinsics[5]
    x, y, z = np.float64(mean[0]), np.float64(mean[1]), np.float64(mean[2])
    u, v, px, py, pz, is_imaged = _pixel(x, y, z, (0.0, 0.0), matrices, moves, intrinsics, lens, scan)
    distance = np.sqrt(px * px + py * py + pz * pz)
    depth = distance if by_distance else pz
    if not (is_imaged and NEAR_M < depth < 3e38):  # also rejects NaN
        return 0.0
    aside, at_u, at_v = (0.0, 0.0), u, v
    if lens[0] < 2:
        across, down = min(max(px / pz, edges[0]), edges[1]), min(max(py / pz, edges[2]), edges[3])
        if across != px / pz or down != py / pz:
            aside = (across * pz - px, down * pz - py)
            at_u, at_v, _, _, _, is_imaged = _pixel(x, y, z, aside, matrices, moves, intrinsics, lens, scan)
            if not is_imaged:
                return 0.0
    m = matrices[0]
    unit = np.sqrt(m[0, 0] * m[0, 0] + m[1, 0] * m[1, 0] + m[2, 0] * m[2, 0])
    longest = unit * max(np.float64(scale[0]), np.float64(scale[1]), np.float64(scale[2])) * _SPREAD
    share = min(1.0, _WIDEST * distance / max(longest, 1e-30))
    axes = rotation_columns(np.float64(q[0]), np.float64(q[1]), np.float64(q[2]), np.float64(q[3]))
    for attempt in range(2):
        mean_u = mean_v = xx = xy = yy = 0.0
        all_imaged = True
        for k in range(3):
            axis = axes[0] if k == 0 else (axes[1] if k == 1 else axes[2])
            step = share * _SPREAD * np.float64(scale[k])
            for side in range(2):
                along = step if side == 0 else -step
                to_u, to_v, _, _, _, seen = _pixel(
                    x + along * axis[0], y + along * axis[1], z + along * axis[2], aside, matrices, moves, intrinsics,
                    lens, scan,
                )  # fmt: skip
                all_imaged = all_imaged and seen
                du, dv = to_u - at_u, to_v - at_v
                mean_u, mean_v = mean_u + du, mean_v + dv
                xx, xy, yy = xx + du * du, xy + du * dv, yy + dv * dv
        if all_imaged and np.isfinite(xx + yy):
            break
        if attempt == 1:
            return 0.0
        share *= _LOCAL / _WIDEST
    # Weights are 0 for the mean and 1/6 for the others; of the covariance, 2 for the mean. With the offsets d from the
    # mean's pixel, and m their mean, it is: sum d d^T / 6 - m m^T + 2 m m^T.
    mean_u, mean_v = mean_u / 6, mean_v / 6
    by_square = 1 / (share * share)
    xx = by_square * (xx / 6 + mean_u * mean_u)
    xy = by_square * (xy / 6 + mean_u * mean_v)
    yy = by_square * (yy / 6 + mean_v * mean_v)
    u, v = u + mean_u, v + mean_v
    if not write_shape(u, v, xx, xy, yy, opacity, is_rain, as_point, antialiased, width, height, shape):
        return 0.0
    point[0], point[1], point[2] = px, py, pz
    return depth
