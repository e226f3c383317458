"""Projection of Gaussians to splats: shape, color and depth in one image."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int32, Int64, UInt32

from ...kernels import NOGIL
from ...scene.camera import Camera
from ...scene.flags import BitMask
from ...scene.scene import DrawItem
from .block_cache import BlockCaches
from .fast_math import sh_basis

NEAR_M = 0.2  # Gaussians with nearer centers are skipped, as in the reference rasterizer
DILATION_PX2 = 0.3  # added to the 2D covariance: the pixel's own footprint (3DGS, Kerbl et al. 2023)
ANTIALIASED_PX2 = 0.1  # the same for antialiased Gaussians: about the variance of a pixel's area (Yu et al. 2024)


SCENE_ALPHA_CUT = 1 / 255  # alpha below which fragments of the scene are skipped, as in the reference rasterizer

RAIN_ALPHA_CUT = 1 / 65536
"""Alpha below which fragments of rain are skipped: streaks of alpha 0.01 would hardly survive a cut at 1/255."""

LOG_SCENE_CUT, LOG_RAIN_CUT = float(np.log(SCENE_ALPHA_CUT)), float(np.log(RAIN_ALPHA_CUT))
"""Values of log_cut in `Splats.shapes`, by which rain is distinguished from the scene."""

MIN_SCENE_CUT = np.float32(LOG_SCENE_CUT - 1)  # threshold between the logarithms of rain (below) and scene (above)

TINT, TINT_SHARE = (1.0, 0.82, 0.15), 0.5
"""Display color of the selection, a warm yellow that is rare in streets, and its share; as in common_tint.glsl."""

FEW = 8192  # number of Gaussians below which a single thread is faster than starting others
CHUNK = 512  # Gaussians that one thread processes at a time


@dataclass(frozen=True, slots=True, eq=False)
class Splats:
    """Gaussians that may be visible to one camera, in their own order.

    A row of `shapes` holds x, y, shear, sharpness_x, sharpness_y, log_opacity, log_cut, reach_x. With the pixel center
    (u, v) and dx = u - x,
        ln alpha = log_opacity + sharpness_x * dx^2 + sharpness_y * (v - y - shear * dx)^2, cut below log_cut,
    where shear = cov_xy / cov_xx, sharpness_x = -1 / (2 cov_xx), sharpness_y = -cov_xx / (2 det), |dx| <= reach_x: the
    2D Gaussian column by column. Both terms are negative, so that long needles suffer no cancellation. Columns suit
    rain: a falling streak touches few of them.
    """

    shapes: Float32[np.ndarray, "m 8"]
    colors: Float32[np.ndarray, "m 4"]
    """Display color, never negative, and depth along the view axis in meters. All 0 for the few that turn out to be
    invisible; they are not drawn.
    """
    indices: Int64[np.ndarray, " m"]
    """Index of the Gaussian, counted through all parts in order; those beyond a part's limit count too.

    Rising from part to part, and inside a part, unless its `members` are in another order.
    """

    def __len__(self) -> int:
        return len(self.indices)

    def nearest_first(self) -> Int32[np.ndarray, " drawn"]:
        return nearest_first(self.colors[:, 3])


def project(
    parts: Sequence[DrawItem],
    camera: Camera,
    rain: Sequence[Bool[np.ndarray, " _"] | None] | None = None,
    *,
    as_points: bool = False,
    caches: BlockCaches | None = None,
) -> Splats:
    """Project Gaussians.

    EWA splatting (Zwicker et al. 2002) as in 3DGS (Kerbl et al. 2023), with gsplat's limits for off-center cameras.
    Gaussians are left out if they are nearer than `NEAR_M`, outside the image, fainter than their cut, not finite or in
    their part's mask. Memory is allocated only for possibly visible ones.

    Args:
        parts: Gaussians with their similarity to the world (meters).
        camera: Camera in the world.
        rain: For each part, the mask of its rain Gaussians (None: none). Rain keeps its integral over the image,
            opacity * sqrt(det / dilated det) (Yu et al. 2024), and is cut at `RAIN_ALPHA_CUT`.
        as_points: Make each an opaque dot with a standard deviation of one pixel instead.
        caches: Holds those members of parts in memory whose Gaussians are mapped from a file.
    """
    intrinsics = intrinsics_of(camera)
    poses = [np.ascontiguousarray(camera.world_to_camera @ part.to_world, np.float64) for part in parts]
    found = [_candidates(part, pose, intrinsics, as_points) for part, pose in zip(parts, poses, strict=True)]
    count = sum(len(each) for each in found)
    shapes, colors = np.empty((count, 8), np.float32), np.empty((count, 4), np.float32)
    indices = np.empty(count, np.int64)
    first = counted = 0
    for number, (part, pose, own) in enumerate(zip(parts, poses, found, strict=True)):
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
        fill = _project_range if len(own) < FEW else _project_chunks
        fill(
            0, len(own), rows, g.means, scales, g.quaternions, g.opacities, sh, wet, np.float32(part.wetness),
            np.zeros(0, np.bool_) if flags is None else flags, np.float32(part.opacity),
            np.ascontiguousarray(change, np.float32), _words(part.selected), as_points, part.gaussians.antialiased,
            pose, eye_in_object(camera, part), intrinsics, shapes[first:last], colors[first:last],
        )  # fmt: skip
        indices[first:last] = own + counted
        first, counted = last, counted + len(part.gaussians)
    return Splats(shapes, colors, indices)


def intrinsics_of(camera: Camera) -> tuple[float, float, float, float, float, float]:
    """Focal lengths, principal point and size in px; unpacking an array would cost more than the whole projection."""
    c = camera
    return float(c.fx), float(c.fy), float(c.cx), float(c.cy), float(c.width), float(c.height)


def _words(mask: BitMask | None) -> UInt32[np.ndarray, " w"]:
    """Bits of a mask, empty without a mask; writable, since read-only arrays would need separate kernels."""
    return np.zeros(0, np.uint32) if mask is None else np.require(mask.words, np.uint32, ("C", "W"))


def eye_in_object(camera: Camera, part: DrawItem) -> Float64[np.ndarray, "3"]:
    """Center of projection in the part's own frame, in which its spherical harmonics are defined."""
    return np.linalg.solve(part.to_world[:3, :3], camera.position - part.to_world[:3, 3])


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
        0, n, g.means[:n], g.scales[:n], g.opacities[:n], _words(part.left_out), faintest, object_to_camera, largest,
        intrinsics, flags,
    )  # fmt: skip
    return np.flatnonzero(flags)


@numba.njit(parallel=True, cache=True, nogil=NOGIL, error_model="numpy")
@no_type_check
def _flag_chunks(first, last, means, scales, opacities, left_out, faintest, m, scale, intrinsics, flags):
    for chunk in numba.prange((last - first + CHUNK - 1) // CHUNK):
        start = first + np.int64(chunk) * CHUNK
        end = min(last, start + CHUNK)
        _flag_range(start, end, means, scales, opacities, left_out, faintest, m, scale, intrinsics, flags)


@numba.njit(cache=True, nogil=NOGIL, error_model="numpy")
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
            flags[i] = flags[i] and not _has(left_out, i)


@numba.njit(inline="always", error_model="numpy")
@no_type_check
def _has(words, i):
    return (words[i >> 5] >> np.uint32(i & 31)) & np.uint32(1) == np.uint32(1)


@numba.njit(parallel=True, cache=True, nogil=NOGIL, error_model="numpy")
@no_type_check
def _project_chunks(
    first, last, members, means, scales, quaternions, opacities, sh, wet_sh, wetness, rain, opacity, change, selected,
    as_points, antialiased, object_to_camera, eye, intrinsics, shapes, colors,
):  # fmt: skip
    for chunk in numba.prange((last - first + CHUNK - 1) // CHUNK):
        start = first + np.int64(chunk) * CHUNK
        _project_range(
            start, min(last, start + CHUNK), members, means, scales, quaternions, opacities, sh, wet_sh, wetness, rain,
            opacity, change, selected, as_points, antialiased, object_to_camera, eye, intrinsics, shapes, colors,
        )  # fmt: skip


@numba.njit(cache=True, nogil=NOGIL, error_model="numpy")
@no_type_check
def _project_range(
    first, last, members, means, scales, quaternions, opacities, sh, wet_sh, wetness, rain, opacity, change, selected,
    as_points, antialiased, object_to_camera, eye, intrinsics, shapes, colors,
):  # fmt: skip
    """Fill shapes and colors of some Gaussians of one part; depth 0 marks those not to be drawn."""
    basis = np.empty(16, np.float32)
    for n in range(first, last):
        i = members[n]
        is_rain = len(rain) > 0 and rain[i]
        depth = _shape(
            means[i], scales[i], quaternions[i], opacity * opacities[i], is_rain, as_points, antialiased,
            object_to_camera, intrinsics, shapes[n],
        )  # fmt: skip
        if not (depth > 0 and _color(means[i], sh[i], wet_sh, i, wetness, eye, change, basis, colors[n])):
            for k in range(8):
                shapes[n, k] = 0
            for k in range(3):
                colors[n, k] = 0
            depth = 0.0
        elif len(selected) > 0 and _has(selected, i):
            for k in range(3):
                colors[n, k] += np.float32(TINT_SHARE) * (np.float32(TINT[k]) - colors[n, k])
        colors[n, 3] = depth


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _shape(mean, scale, q, opacity, is_rain, as_point, antialiased, m, intrinsics, shape):
    """Write one splat's shape; return its depth in meters, or 0 if it is not to be drawn.

    Scalars are float64: 1e12 m squared still fits.
    """
    fx, fy, cx, cy, width, height = intrinsics
    px, py, pz = in_camera(m, mean)
    if not (NEAR_M < pz < 3e38):  # also rejects NaN
        return 0.0
    near = 1 / pz
    row_u, row_v, _, _, _, _ = jacobian(px, py, pz, m, intrinsics)
    first, second, third = rotation_columns(np.float64(q[0]), np.float64(q[1]), np.float64(q[2]), np.float64(q[3]))
    a, b, c = np.float64(scale[0]), np.float64(scale[1]), np.float64(scale[2])
    u0, v0 = a * dot(row_u, first), a * dot(row_v, first)
    u1, v1 = b * dot(row_u, second), b * dot(row_v, second)
    u2, v2 = c * dot(row_u, third), c * dot(row_v, third)
    xx, xy, yy = u0 * u0 + u1 * u1 + u2 * u2, u0 * v0 + u1 * v1 + u2 * v2, v0 * v0 + v1 * v1 + v2 * v2
    before = max(xx * yy - xy * xy, 0.0)
    footprint = ANTIALIASED_PX2 if antialiased else DILATION_PX2
    xx += footprint
    yy += footprint
    if as_point:
        xx, xy, yy, opacity = 1.0, 0.0, 1.0, np.float32(1)
    determinant = xx * yy - xy * xy
    if not (0 < determinant < np.inf):
        return 0.0
    alpha = min(np.float64(opacity), 1.0)
    log_cut = LOG_SCENE_CUT
    if is_rain or (antialiased and not as_point):
        alpha *= np.sqrt(before / determinant)
    if is_rain:
        log_cut = LOG_RAIN_CUT
    log_alpha = np.log(alpha)
    if not (log_alpha > log_cut):
        return 0.0
    extent = np.sqrt(2 * (log_alpha - log_cut))  # exact: alpha is the cut at the edge
    u, v = fx * px * near + cx, fy * py * near + cy
    reach_x, reach_y = extent * np.sqrt(xx), extent * np.sqrt(yy)
    if not (u + reach_x > 0 and u - reach_x < width and v + reach_y > 0 and v - reach_y < height):
        return 0.0
    by_xx = 1 / xx
    shape[0], shape[1] = u, v
    shape[2] = xy * by_xx
    shape[3] = -0.5 * by_xx
    shape[4] = -0.5 * xx / determinant
    shape[5], shape[6] = log_alpha, log_cut
    shape[7] = reach_x
    return pz


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
def rotation_columns(w, x, y, z):
    """Columns of the rotation of a unit quaternion."""
    first = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
    second = 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)
    third = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
    return first, second, third


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(forceinline=True, error_model="numpy")
@no_type_check
def _color(mean, sh, wet_sh, i, wetness, eye, change, basis, color):
    """Write the display color, max(0, change of (sum of harmonics + 0.5)); return whether it is finite.

    If there are wet harmonics, their row i is blended in before the change.
    """
    x, y, z = mean[0] - eye[0], mean[1] - eye[1], mean[2] - eye[2]
    by_length = 1 / np.sqrt(x * x + y * y + z * z)
    coefficients = sh.shape[0]
    sh_basis(np.float32(x * by_length), np.float32(y * by_length), np.float32(z * by_length), coefficients, basis)
    red = green = blue = np.float32(0.5)
    for k in range(coefficients):
        red += basis[k] * sh[k, 0]
        green += basis[k] * sh[k, 1]
        blue += basis[k] * sh[k, 2]
    if len(wet_sh) > 0:
        r = g = b = np.float32(0.5)
        for k in range(coefficients):
            r += basis[k] * wet_sh[i, k, 0]
            g += basis[k] * wet_sh[i, k, 1]
            b += basis[k] * wet_sh[i, k, 2]
        dry = np.float32(1) - wetness
        red, green, blue = dry * red + wetness * r, dry * green + wetness * g, dry * blue + wetness * b
    if len(change) > 0:
        r, g, b = red, green, blue
        red = change[0, 0] * r + change[0, 1] * g + change[0, 2] * b + change[0, 3]
        green = change[1, 0] * r + change[1, 1] * g + change[1, 2] * b + change[1, 3]
        blue = change[2, 0] * r + change[2, 1] * g + change[2, 2] * b + change[2, 3]
    color[0], color[1], color[2] = max(red, np.float32(0)), max(green, np.float32(0)), max(blue, np.float32(0))
    return np.isfinite(red) and np.isfinite(green) and np.isfinite(blue)


def nearest_first(depths: Float[np.ndarray, " m"]) -> Int32[np.ndarray, " drawn"]:
    """Rows with a depth above 0, sorted by it as float32; equal depths keep their index.

    One 64-bit number each, depth above row: all are distinct, so any fast sort is stable. The bits of a positive
    float32 sort like the number itself.
    """
    depths = np.ascontiguousarray(depths, np.float32)
    rows = np.flatnonzero(depths)
    keys = depths[rows].view(np.uint32).astype(np.uint64)
    keys <<= np.uint64(32)
    keys |= rows.astype(np.uint64)
    keys.sort()
    return keys.astype(np.uint32).view(np.int32)  # the lower halves
