"""Projection of Gaussians to splats: shape, color and depth in one image."""

from collections.abc import Sequence
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from ...fast_math import stack_lines
from ...kernels import kernel, range_of
from ...scene.camera import Camera
from ...scene.scene import DrawItem
from .block_cache import BlockCaches
from .lens_projection import RollingPose, lens_candidates, lens_view, project_through_lens, rolling_pose
from .splats import (
    CHUNK,
    DILATION_PX2,
    FEW,
    LOG_RAIN_CUT,
    NEAR_M,
    RAIN_ALPHA_CUT,
    Splats,
    direction_to,
    eye_in_object,
    has_bit,
    mask_words,
    nearest_m,
    rotation_columns,
    shape_of,
    with_footprint,
    write_colors,
)

_BLOCK = 64  # Gaussians that are projected together


def project(
    parts: Sequence[DrawItem],
    camera: Camera,
    rain: Sequence[Bool[np.ndarray, " _"] | None] | None = None,
    *,
    as_points: bool = False,
    caches: BlockCaches | None = None,
    held: Sequence[int] = (),
) -> Splats:
    """Project Gaussians.

    EWA splatting (Zwicker et al. 2002) as in 3DGS (Kerbl et al. 2023), with gsplat's limits for off-center cameras.
    Gaussians are left out if they are nearer than `NEAR_M`, before an orthographic camera's plane, outside the image,
    fainter than their cut, not finite or in their part's mask. Memory is allocated only for possibly visible ones.

    Args:
        parts: Gaussians with their similarity to the world (meters).
        camera: Camera in the world.
        rain: For each part, the mask of its rain Gaussians (None: none). Rain keeps its integral over the image,
            opacity * sqrt(det / dilated det) (Yu et al. 2024), and is cut at `RAIN_ALPHA_CUT`.
        as_points: Make each an opaque dot with a standard deviation of one pixel instead.
        caches: Holds those members of parts in memory whose Gaussians are mapped from a file.
        held: Numbers of the parts that a rolling shutter does not move: they are where their rows have them.

    A camera with a lens or a rolling shutter projects them by the unscented transform, see lens_projection.py. For a
    `Camera.band`, the splats of the whole picture are returned.
    """
    intrinsics = intrinsics_of(camera.whole)
    view = None if camera.is_pinhole else lens_view(camera)
    poses: list[Float64[np.ndarray, "4 4"]] = []
    rolling: list[RollingPose] = []
    if view is None:
        poses = [np.ascontiguousarray(camera.world_to_camera @ part.to_world, np.float64) for part in parts]
        found = [_candidates(part, pose, intrinsics, as_points) for part, pose in zip(parts, poses, strict=True)]
    else:
        rolling = [rolling_pose(part, camera, is_held=number in held) for number, part in enumerate(parts)]
        found = [lens_candidates(*each, view, as_points=as_points) for each in zip(parts, rolling, strict=True)]
    count = sum(len(each) for each in found)
    points = None if view is None else np.empty((count, 3), np.float32)
    shapes, colors = np.empty((count, 8), np.float32), np.empty((count, 4), np.float32)
    indices = np.empty(count, np.int64)
    first = counted = 0
    for number, (part, own) in enumerate(zip(parts, found, strict=True)):
        g, last = part.gaussians, first + len(own)
        flags = rain[number] if rain is not None else None
        end = part.drawn_count if part.members is None else len(g)
        scales = g.scales if part.growth == 1 else g.scales[:end] * np.float32(part.growth)
        wet_sh, rows = part.wet_sh if part.is_wet else None, own
        if caches is not None and part.members is not None and part.selected is None and part.growth == 1:
            g, wet_sh, rows = caches.present(g, wet_sh, own)
            scales = g.scales
        # What a part lacks has no rows: the kernels skip it. When fully wet, its clear colors have no share.
        sh, wet = g.sh, np.zeros((0, 1, 3), np.float32)
        if wet_sh is not None:
            soaked = np.require(wet_sh, np.float32, ("C", "W"))
            sh, wet = (soaked, wet) if part.wetness == 1 else (sh, soaked)
        change = np.zeros((0, 4)) if part.colors is None else part.colors
        values = (
            rows, g.means, scales, g.quaternions, g.opacities, sh, wet, np.float32(part.wetness),
            np.zeros(0, np.bool_) if flags is None else flags, np.float32(part.opacity),
            np.ascontiguousarray(change, np.float32), mask_words(part.selected), as_points, part.gaussians.antialiased,
        )  # fmt: skip
        if view is None or points is None:
            fill = _project_range if len(own) < FEW else _project_chunks
            fill(
                0, len(own), *values, poses[number], eye_in_object(camera, part), intrinsics, shapes[first:last],
                colors[first:last],
            )  # fmt: skip
        else:
            project_through_lens(
                *values, *rolling[number][:3], view.intrinsics, view.lens, view.scan, view.by_distance, view.edges,
                shapes[first:last], colors[first:last], points[first:last],
            )  # fmt: skip
        indices[first:last] = own + counted
        first, counted = last, counted + len(part.gaussians)
    if camera.is_orthographic:
        colors[colors[:, 3] < nearest_m(camera), 3] = 0
    if camera.rows_outside[0]:
        shapes[:, 1] -= np.float32(camera.rows_outside[0])
    return Splats(shapes, colors, indices, points)


def intrinsics_of(camera: Camera) -> tuple[float, float, float, float, float, float]:
    """Focal lengths, principal point and size in px; unpacking an array would cost more than the whole projection."""
    c = camera
    return float(c.fx), float(c.fy), float(c.cx), float(c.cy), float(c.width), float(c.height)


def view_directions(
    parts: Sequence[DrawItem], camera: Camera, indices: Int64[np.ndarray, " m"]
) -> Float32[np.ndarray, "m 3"]:
    """Unit directions from the eye to Gaussians, each in its own part's frame; `indices` count through all parts."""
    directions = np.empty((len(indices), 3), np.float32)
    first = 0
    for part in parts:
        last = first + len(part.gaussians)
        own = np.flatnonzero((indices >= first) & (indices < last))
        offsets = part.gaussians.means[indices[own] - first] - eye_in_object(camera, part)
        directions[own] = offsets / np.linalg.norm(offsets, axis=1, keepdims=True)
        first = last
    return directions


def _candidates(
    part: DrawItem, object_to_camera: Float64[np.ndarray, "4 4"], intrinsics: tuple[float, ...], as_points: bool
) -> Int64[np.ndarray, " m"]:
    """Indices of a part's possibly visible Gaussians: all visible ones, and few others."""
    if part.members is not None:
        return part.members if part.opacity > 0 else part.members[:0]
    g, n = part.gaussians, part.drawn_count if part.opacity > 0 else 0
    flags = np.empty(n, np.bool_)
    largest = part.growth * np.cbrt(abs(np.linalg.det(object_to_camera[:3, :3])))
    faintest = -np.inf if as_points or n == 0 else RAIN_ALPHA_CUT / part.opacity
    find = _flag_range if n < FEW else _flag_chunks
    find(
        0, n, g.means[:n], g.scales[:n], g.opacities[:n], mask_words(part.left_out), faintest, object_to_camera,
        largest, intrinsics, flags,
    )  # fmt: skip
    return np.flatnonzero(flags)


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _flag_chunks(portion, first, last, means, scales, opacities, left_out, faintest, m, scale, intrinsics, flags):
    for chunk in range_of(portion, (last - first + CHUNK - 1) // CHUNK):
        start = first + np.int64(chunk) * CHUNK
        end = min(last, start + CHUNK)
        _flag_range(start, end, means, scales, opacities, left_out, faintest, m, scale, intrinsics, flags)


@kernel(error_model="numpy")
@no_type_check
def _flag_range(first, last, means, scales, opacities, left_out, faintest, m, scale, intrinsics, flags):
    """Flag Gaussians near the image, each treated as a ball with the radius of its longest axis."""
    fx, fy, cx, cy, width, height = intrinsics
    half_x, half_y = 0.5 * width, 0.5 * height
    # Longest extents in standard deviations, along a line of sight as slanted as `_shape` allows for.
    extent = np.sqrt(-2 * LOG_RAIN_CUT)
    slope_x, slope_y = max(cx, width - cx) / fx + 0.15 * width / fx, max(cy, height - cy) / fy + 0.15 * height / fy
    reach_x = extent * scale * fx * np.sqrt(1 + slope_x * slope_x)
    reach_y = extent * scale * fy * np.sqrt(1 + slope_y * slope_y)
    dot = extent * np.sqrt(1 + DILATION_PX2)
    for i in range(first, last):
        px, py, pz = in_camera(m, means[i])
        s = max(scales[i, 0], scales[i, 1], scales[i, 2])
        is_near_x = abs(fx * px + (cx - half_x) * pz) <= (half_x + dot) * pz + reach_x * s
        is_near_y = abs(fy * py + (cy - half_y) * pz) <= (half_y + dot) * pz + reach_y * s
        flags[i] = pz > NEAR_M and is_near_x and is_near_y and opacities[i] > faintest
    if len(left_out) > 0:  # separate, so that the loop above stays branch-free
        for i in range(first, last):
            flags[i] = flags[i] and not has_bit(left_out, i)


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _project_chunks(
    portion, first, last, members, means, scales, quaternions, opacities, sh, wet_sh, wetness, rain, opacity, change,
    selected, as_points, antialiased, object_to_camera, eye, intrinsics, shapes, colors,
):  # fmt: skip
    for chunk in range_of(portion, (last - first + CHUNK - 1) // CHUNK):
        start = first + np.int64(chunk) * CHUNK
        _project_range(
            start, min(last, start + CHUNK), members, means, scales, quaternions, opacities, sh, wet_sh, wetness, rain,
            opacity, change, selected, as_points, antialiased, object_to_camera, eye, intrinsics, shapes, colors,
        )  # fmt: skip


@kernel(error_model="numpy")
@no_type_check
def _project_range(
    first, last, members, means, scales, quaternions, opacities, sh, wet_sh, wetness, rain, opacity, change, selected,
    as_points, antialiased, object_to_camera, eye, intrinsics, shapes, colors,
):  # fmt: skip
    """Fill shapes and colors of some Gaussians of one part; depth 0 marks those not to be drawn.

    Block by block, in lines of numbers, so that LLVM vectorizes all but logarithms and colors.
    """
    source, results = stack_lines(12, _BLOCK, shapes.dtype), stack_lines(9, _BLOCK, shapes.dtype)
    places = stack_lines(8, _BLOCK, object_to_camera.dtype)
    directions = np.zeros((_BLOCK, 3), np.float32)
    for start in range(first, last, _BLOCK):
        count = min(_BLOCK, last - start)
        for j in range(count):
            i = members[start + j]
            for k in range(3):
                source[k * _BLOCK + j], source[(3 + k) * _BLOCK + j] = means[i, k], scales[i, k]
            for k in range(4):
                source[(6 + k) * _BLOCK + j] = quaternions[i, k]
            source[10 * _BLOCK + j] = opacity * opacities[i]
            source[11 * _BLOCK + j] = 1 if len(rain) > 0 and rain[i] else 0
        _place(source, count, as_points, antialiased, object_to_camera, intrinsics, places)
        for j in range(count):
            places[7 * _BLOCK + j] = np.log(places[7 * _BLOCK + j])
        _finish(source, places, count, intrinsics, results)
        for j in range(count):
            for k in range(8):
                shapes[start + j, k] = results[k * _BLOCK + j]
            for k in range(3):
                colors[start + j, k] = 0
            colors[start + j, 3] = results[8 * _BLOCK + j]
        if sh.shape[1] > 1:
            for j in range(count):
                mean = source[j], source[_BLOCK + j], source[2 * _BLOCK + j]
                directions[j, 0], directions[j, 1], directions[j, 2] = direction_to(mean, eye)
        write_colors(start, start + count, members, directions, sh, wet_sh, wetness, change, selected, shapes, colors)


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _place(source, count, as_points, antialiased, m, intrinsics, places):
    """Centers, covariances, depths and alphas of splats; the depth is 0 out of reach.

    Scalars are float64: 1e12 m squared still fits.
    """
    fx, fy, cx, cy, _, _ = intrinsics
    for j in range(count):
        px, py, pz = in_camera(m, (source[j], source[_BLOCK + j], source[2 * _BLOCK + j]))
        near = 1 / pz
        row_u, row_v, _, _, _, _ = jacobian(px, py, pz, m, intrinsics)
        w, x = np.float64(source[6 * _BLOCK + j]), np.float64(source[7 * _BLOCK + j])
        y, z = np.float64(source[8 * _BLOCK + j]), np.float64(source[9 * _BLOCK + j])
        first, second, third = rotation_columns(w, x, y, z)
        a, b = np.float64(source[3 * _BLOCK + j]), np.float64(source[4 * _BLOCK + j])
        c = np.float64(source[5 * _BLOCK + j])
        u0, v0 = a * dot(row_u, first), a * dot(row_v, first)
        u1, v1 = b * dot(row_u, second), b * dot(row_v, second)
        u2, v2 = c * dot(row_u, third), c * dot(row_v, third)
        xx, xy, yy = u0 * u0 + u1 * u1 + u2 * u2, u0 * v0 + u1 * v1 + u2 * v2, v0 * v0 + v1 * v1 + v2 * v2
        is_rain = source[11 * _BLOCK + j] > 0
        xx, xy, yy, determinant, alpha = with_footprint(
            xx, xy, yy, source[10 * _BLOCK + j], is_rain, as_points, antialiased
        )
        places[j], places[_BLOCK + j] = fx * px * near + cx, fy * py * near + cy
        places[2 * _BLOCK + j], places[3 * _BLOCK + j], places[4 * _BLOCK + j] = xx, xy, yy
        places[5 * _BLOCK + j] = determinant
        places[6 * _BLOCK + j] = pz if (pz > NEAR_M) & (pz < 3e38) else 0.0  # also rejects NaN
        places[7 * _BLOCK + j] = alpha


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _finish(source, places, count, intrinsics, results):
    """Shapes of splats whose alphas became logarithms, and depths, which are 0 for those not to be drawn."""
    width, height = intrinsics[4], intrinsics[5]
    for j in range(count):
        u, v, depth = places[j], places[_BLOCK + j], places[6 * _BLOCK + j]
        xx, xy, yy = places[2 * _BLOCK + j], places[3 * _BLOCK + j], places[4 * _BLOCK + j]
        determinant, log_alpha = places[5 * _BLOCK + j], places[7 * _BLOCK + j]
        is_rain = source[11 * _BLOCK + j] > 0
        is_drawn, shape = shape_of(u, v, xx, xy, yy, determinant, log_alpha, is_rain, width, height)
        is_drawn &= depth > 0
        for k in range(8):
            results[k * _BLOCK + j] = shape[k] if is_drawn else 0.0
        results[8 * _BLOCK + j] = depth if is_drawn else 0.0


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def in_camera(m, mean):
    """Mean in the frame of the camera, of which m is the matrix."""
    px = m[0, 0] * mean[0] + m[0, 1] * mean[1] + m[0, 2] * mean[2] + m[0, 3]
    py = m[1, 0] * mean[0] + m[1, 1] * mean[1] + m[1, 2] * mean[2] + m[1, 3]
    pz = m[2, 0] * mean[0] + m[2, 1] * mean[1] + m[2, 2] * mean[2] + m[2, 3]
    return px, py, pz


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def jacobian(px, py, pz, m, intrinsics):
    """Local affine approximation of the projection: two rows that map the object's axes to pixels.

    Also the slopes used, clamped at 1.3 times the field of view, and whether each is unclamped: a clamped one no longer
    depends on the mean.
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
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
