"""Projection of Gaussians to splats: shape, color and depth in one image."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int32, Int64, UInt32

from ...scene.camera import Camera
from ...scene.flags import BitMask
from ...scene.scene import DrawItem
from .fast_math import sh_basis

NEAR_M = 0.2
"""Gaussians with nearer centers are skipped, as in the reference rasterizer."""

DILATION_PX2 = 0.3
"""Added to the 2D covariance: the pixel's own footprint (3DGS, Kerbl et al. 2023)."""

_CHUNK = 512
FEW = 8192
"""Number of Gaussians below which a single thread is faster than starting others."""

_Flags = Sequence[Bool[np.ndarray, " _"] | None]


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
    """Index of the Gaussian, counted through all parts in order, rising; those beyond a part's limit count too."""

    def __len__(self) -> int:
        return len(self.indices)

    @property
    def is_rain(self) -> Bool[np.ndarray, " m"]:
        return self.shapes[:, 6] < MIN_SCENE_CUT

    def nearest_first(self) -> Int32[np.ndarray, " drawn"]:
        return nearest_first(self.colors[:, 3])


def project(
    parts: Sequence[DrawItem], camera: Camera, rain: _Flags | None = None, *, as_points: bool = False
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
    """
    intrinsics = _intrinsics(camera)
    ways = [np.ascontiguousarray(camera.world_to_camera @ part.to_world, np.float64) for part in parts]
    found = [_candidates(part, way, intrinsics, as_points) for part, way in zip(parts, ways, strict=True)]
    count = sum(len(each) for each in found)
    shapes, colors = np.empty((count, 8), np.float32), np.empty((count, 4), np.float32)
    indices = np.empty(count, np.int64)
    first = counted = 0
    for number, (part, way, own) in enumerate(zip(parts, ways, found, strict=True)):
        g, last = part.gaussians, first + len(own)
        flags = rain[number] if rain is not None else None
        scales = g.scales if part.growth == 1 else g.scales[: part.drawn_count] * np.float32(part.growth)
        fill = _project_few if len(own) < FEW else _project_part
        fill(
            own, g.means, scales, g.quaternions, g.opacities, g.sh, _wet_sh(part), np.float32(part.wetness),
            np.zeros(0, np.bool_) if flags is None else flags, np.float32(part.opacity), _color_change(part),
            _words(part.selected), as_points, way, eye_in_object(camera, part), intrinsics,
            shapes[first:last], colors[first:last],
        )  # fmt: skip
        indices[first:last] = own + counted
        first, counted = last, counted + len(g)
    return Splats(shapes, colors, indices)


def _intrinsics(camera: Camera) -> tuple[float, ...]:
    # A tuple: unpacking an array would count references, which costs more than the whole projection.
    sizes = camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height
    return tuple(float(size) for size in sizes)


def _words(mask: BitMask | None) -> UInt32[np.ndarray, " w"]:
    """Bits of a mask, empty without a mask; writable, since read-only arrays would need separate kernels."""
    return np.zeros(0, np.uint32) if mask is None else np.require(mask.words, np.uint32, ("C", "W"))


def _color_change(part: DrawItem) -> Float32[np.ndarray, "rows 4"]:
    """Affine change of a part's display colors; no rows without one."""
    return np.zeros((0, 4), np.float32) if part.colors is None else np.ascontiguousarray(part.colors, np.float32)


def _wet_sh(part: DrawItem) -> Float32[np.ndarray, "_ _ 3"]:
    """Wet harmonics to blend in; no rows without any, which the kernels skip."""
    if part.wet_sh is None or not part.is_wet:
        return np.zeros((0, 1, 3), np.float32)
    return np.require(part.wet_sh, np.float32, ("C", "W"))


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
    g, n = part.gaussians, part.drawn_count if part.opacity > 0 else 0
    flags = np.empty(n, np.bool_)
    largest = part.growth * np.cbrt(abs(np.linalg.det(object_to_camera[:3, :3])))
    least = -np.inf if as_points or n == 0 else RAIN_ALPHA_CUT / part.opacity
    left_out = _words(part.left_out)
    find = _find_few_candidates if n < FEW else _find_candidates
    find(g.means[:n], g.scales[:n], g.opacities[:n], left_out, least, object_to_camera, largest, intrinsics, flags)
    return np.flatnonzero(flags)


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check
def _find_candidates(means, scales, opacities, left_out, least_opacity, m, scale, intrinsics, flags):
    """Flag Gaussians near the image, each treated as a ball with the radius of its longest axis."""
    for chunk in numba.prange((len(means) + _CHUNK - 1) // _CHUNK):
        first, last = chunk * _CHUNK, min(len(means), (chunk + 1) * _CHUNK)
        _flag_range(first, last, means, scales, opacities, left_out, least_opacity, m, scale, intrinsics, flags)


@numba.njit(cache=True, error_model="numpy")
@no_type_check
def _find_few_candidates(means, scales, opacities, left_out, least_opacity, m, scale, intrinsics, flags):
    _flag_range(0, len(means), means, scales, opacities, left_out, least_opacity, m, scale, intrinsics, flags)


@numba.njit(error_model="numpy")
@no_type_check
def _flag_range(first, last, means, scales, opacities, left_out, least_opacity, m, scale, intrinsics, flags):
    fx, fy, cx, cy, width, height = intrinsics
    half_x, half_y = 0.5 * width, 0.5 * height
    # Longest extents in standard deviations, along a line of sight as slanted as `_shape` allows for.
    extent = np.sqrt(-2 * LOG_RAIN_CUT)
    slope_x, slope_y = max(cx, width - cx) / fx + 0.15 * width / fx, max(cy, height - cy) / fy + 0.15 * height / fy
    reach_x = extent * scale * fx * np.sqrt(1 + slope_x * slope_x)
    reach_y = extent * scale * fy * np.sqrt(1 + slope_y * slope_y)
    dot = extent * np.sqrt(1 + DILATION_PX2)
    for i in range(first, last):
        x, y, z = means[i, 0], means[i, 1], means[i, 2]
        px = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
        py = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
        pz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        s = max(scales[i, 0], scales[i, 1], scales[i, 2])
        is_near_x = abs(fx * px + (cx - half_x) * pz) <= (half_x + dot) * pz + reach_x * s
        is_near_y = abs(fy * py + (cy - half_y) * pz) <= (half_y + dot) * pz + reach_y * s
        flags[i] = pz > NEAR_M and is_near_x and is_near_y and opacities[i] > least_opacity
    if len(left_out) > 0:  # separate, so that the loop above stays branch-free
        for i in range(first, last):
            flags[i] = flags[i] and not _has(left_out, i)


@numba.njit(inline="always", error_model="numpy")
@no_type_check
def _has(words, i):
    return (words[i >> 5] >> np.uint32(i & 31)) & np.uint32(1) == np.uint32(1)


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check
def _project_part(
    members, means, scales, quaternions, opacities, sh, wet_sh, wetness, rain, opacity, change, selected, as_points,
    object_to_camera, eye, intrinsics, shapes, colors,
):  # fmt: skip
    """Fill shapes and colors of some Gaussians of one part; depth 0 marks those not to be drawn."""
    for chunk in numba.prange((len(members) + _CHUNK - 1) // _CHUNK):
        _project_range(
            chunk * _CHUNK, min(len(members), (chunk + 1) * _CHUNK), members, means, scales, quaternions, opacities, sh,
            wet_sh, wetness, rain, opacity, change, selected, as_points, object_to_camera, eye, intrinsics, shapes,
            colors,
        )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
@no_type_check
def _project_few(
    members, means, scales, quaternions, opacities, sh, wet_sh, wetness, rain, opacity, change, selected, as_points,
    object_to_camera, eye, intrinsics, shapes, colors,
):  # fmt: skip
    _project_range(
        0, len(members), members, means, scales, quaternions, opacities, sh, wet_sh, wetness, rain, opacity, change,
        selected, as_points, object_to_camera, eye, intrinsics, shapes, colors,
    )  # fmt: skip


@numba.njit(error_model="numpy")
@no_type_check
def _project_range(
    first, last, members, means, scales, quaternions, opacities, sh, wet_sh, wetness, rain, opacity, change, selected,
    as_points, object_to_camera, eye, intrinsics, shapes, colors,
):  # fmt: skip
    basis = np.empty(16, np.float32)
    for n in range(first, last):
        i = members[n]
        is_rain = len(rain) > 0 and rain[i]
        depth = _shape(
            means[i], scales[i], quaternions[i], opacity * opacities[i], is_rain, as_points, object_to_camera,
            intrinsics, shapes[n],
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
def _shape(mean, scale, q, opacity, is_rain, as_point, m, intrinsics, shape):
    """Write one splat's shape; return its depth in meters, or 0 if it is not to be drawn.

    Scalars are float64: 1e12 m squared still fits.
    """
    fx, fy, cx, cy, width, height = intrinsics
    px = m[0, 0] * mean[0] + m[0, 1] * mean[1] + m[0, 2] * mean[2] + m[0, 3]
    py = m[1, 0] * mean[0] + m[1, 1] * mean[1] + m[1, 2] * mean[2] + m[1, 3]
    pz = m[2, 0] * mean[0] + m[2, 1] * mean[1] + m[2, 2] * mean[2] + m[2, 3]
    if not (NEAR_M < pz < 3e38):  # also rejects NaN
        return 0.0

    # Local affine approximation of the projection, clamped at 1.3 times the field of view: two rows that map the
    # object's axes to pixels.
    near = 1 / pz
    margin_x, margin_y = 0.15 * width, 0.15 * height
    slope_x = min(max(fx * px * near, -cx - margin_x), width - cx + margin_x)
    slope_y = min(max(fy * py * near, -cy - margin_y), height - cy + margin_y)
    ux, vx = near * (fx * m[0, 0] - slope_x * m[2, 0]), near * (fy * m[1, 0] - slope_y * m[2, 0])
    uy, vy = near * (fx * m[0, 1] - slope_x * m[2, 1]), near * (fy * m[1, 1] - slope_y * m[2, 1])
    uz, vz = near * (fx * m[0, 2] - slope_x * m[2, 2]), near * (fy * m[1, 2] - slope_y * m[2, 2])
    w, x, y, z = np.float64(q[0]), np.float64(q[1]), np.float64(q[2]), np.float64(q[3])
    a, b, c = np.float64(scale[0]), np.float64(scale[1]), np.float64(scale[2])
    u0, v0 = _along(a, 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y), ux, uy, uz, vx, vy, vz)
    u1, v1 = _along(b, 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x), ux, uy, uz, vx, vy, vz)
    u2, v2 = _along(c, 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y), ux, uy, uz, vx, vy, vz)
    xx, xy, yy = u0 * u0 + u1 * u1 + u2 * u2, u0 * v0 + u1 * v1 + u2 * v2, v0 * v0 + v1 * v1 + v2 * v2
    before = max(xx * yy - xy * xy, 0.0)
    xx += DILATION_PX2
    yy += DILATION_PX2
    if as_point:
        xx, xy, yy, opacity = 1.0, 0.0, 1.0, np.float32(1)
    determinant = xx * yy - xy * xy
    if not (0 < determinant < np.inf):
        return 0.0
    alpha = min(np.float64(opacity), 1.0)
    log_cut = LOG_SCENE_CUT
    if is_rain:
        alpha *= np.sqrt(before / determinant)
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


@numba.njit(inline="always", error_model="numpy")
@no_type_check
def _along(length, x, y, z, ux, uy, uz, vx, vy, vz):
    return length * (ux * x + uy * y + uz * z), length * (vx * x + vy * y + vz * z)


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


SCENE_ALPHA_CUT = 1 / 255
"""Alpha below which fragments of the scene are skipped, as in the reference rasterizer."""

RAIN_ALPHA_CUT = 1 / 65536
"""Alpha below which fragments of rain are skipped: streaks of alpha 0.01 would hardly survive a cut at 1/255."""

LOG_SCENE_CUT, LOG_RAIN_CUT = float(np.log(SCENE_ALPHA_CUT)), float(np.log(RAIN_ALPHA_CUT))
"""Values of log_cut in `Splats.shapes`, by which rain is distinguished from the scene."""

MIN_SCENE_CUT = np.float32(LOG_SCENE_CUT - 1)
"""Threshold between the logarithms of rain (below) and scene (above)."""


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


# Selection tint
# The same as in common_tint.glsl.

TINT = (1.0, 0.82, 0.15)
"""Display color of the selection: a warm yellow, rare in streets."""

TINT_SHARE = 0.5
"""Share of the tint in a selected splat's color."""
