"""Gaussians in the world -> splats: what each of them is in one image, sorted by depth."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import Part

from .spherical_harmonics import sh_basis

NEAR_M = 0.2
"""Gaussians whose centre is nearer than this are left out, as in the reference rasterizer."""

DILATION_PX2 = 0.3
"""Added to the 2D covariance: the pixel's own footprint (3DGS, Kerbl et al. 2023)."""

SCENE_ALPHA_CUT = 1 / 255
"""Fainter fragments of the scene are left out, as in the reference rasterizer."""

RAIN_ALPHA_CUT = 1 / 65536
"""The same for rain: a streak's alpha is about 0.01, of which 1/255 would leave nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Splats:
    """Gaussians as one camera sees them, nearest first; equal depths keep their index.

    A row of `shapes` holds x, y, shear, sharpness_x, sharpness_y, log_opacity, log_cut, reach_y. With the pixel centre
    (u, v) and dy = v - y,

        ln alpha = log_opacity + sharpness_y * dy^2 + sharpness_x * (u - x - shear * dy)^2, cut below log_cut,

    where shear = cov_xy / cov_yy, sharpness_x = -cov_yy / (2 det), sharpness_y = -1 / (2 cov_yy), |dy| <= reach_y: the
    2D Gaussian row by row, both terms negative, so that no cancellation spoils long needles.
    """

    shapes: Float32[np.ndarray, "m 8"]
    colors: Float32[np.ndarray, "m 4"]
    """Display colour, never negative, and depth along the view axis in metres."""
    indices: Int64[np.ndarray, " m"]
    """Which Gaussian it is, counted through all parts in order."""

    def __len__(self) -> int:
        return len(self.indices)


@dataclass(frozen=True, slots=True, eq=False)
class UnsortedSplats:
    """One splat for each Gaussian of all parts, in their order; columns as in `Splats`."""

    depths: Float32[np.ndarray, " n"]
    """Along the view axis in metres; 0 for what is not drawn, whose other numbers mean nothing."""
    shapes: Float32[np.ndarray, "n 8"]
    colors: Float32[np.ndarray, "n 4"]

    def nearest_first(self) -> Splats:
        """Sort what is drawn by depth."""
        order = _nearest_first(self.depths)
        return Splats(*_gathered(self.shapes, self.colors, order), order)


def project(
    parts: Sequence[Part], camera: Camera, rain: Sequence[Bool[np.ndarray, " _"] | None] | None = None
) -> Splats:
    """Project Gaussians and sort the visible ones by depth; arguments as in `project_unsorted`."""
    return project_unsorted(parts, camera, rain).nearest_first()


def project_unsorted(
    parts: Sequence[Part], camera: Camera, rain: Sequence[Bool[np.ndarray, " _"] | None] | None = None
) -> UnsortedSplats:
    """Project Gaussians.

    EWA splatting (Zwicker et al. 2002) as in 3DGS (Kerbl et al. 2023), with gsplat's limits for off-centre cameras.
    What is nearer than `NEAR_M`, outside the image, fainter than its cut or not finite is left out.

    Args:
        parts: Gaussians with their similarity to the world (metres).
        camera: Where it is seen from.
        rain: For each part, which of its Gaussians are rain (None: none of them). Rain keeps its integral over the
            image, opacity * sqrt(det / dilated det) (Yu et al. 2024), and is cut at `RAIN_ALPHA_CUT`.
    """
    count = sum(len(part.gaussians) for part in parts)
    depths = np.zeros(count, np.float32)
    shapes = np.empty((count, 8), np.float32)
    colors = np.empty((count, 4), np.float32)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height], np.float64)
    first = 0
    for index, part in enumerate(parts):
        g = part.gaussians
        last = first + len(g)
        flags = rain[index] if rain is not None else None
        object_to_camera = np.ascontiguousarray(camera.world_to_camera @ part.to_world, np.float64)
        _project_part(
            g.means, g.scales, g.quaternions, g.opacities, g.sh, np.zeros(0, np.bool_) if flags is None else flags,
            object_to_camera, eye_in_object(camera, part), intrinsics,
            depths[first:last], shapes[first:last], colors[first:last],
        )  # fmt: skip
        first = last
    return UnsortedSplats(depths, shapes, colors)


def eye_in_object(camera: Camera, part: Part) -> Float64[np.ndarray, "3"]:
    """Centre of projection in the part's own frame, where its spherical harmonics live."""
    return np.linalg.solve(part.to_world[:3, :3], camera.position - part.to_world[:3, 3])


def view_directions(
    parts: Sequence[Part], camera: Camera, indices: Int64[np.ndarray, " m"]
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


def _nearest_first(depths: Float32[np.ndarray, " n"]) -> Int64[np.ndarray, " m"]:
    visible = np.flatnonzero(depths)
    # One 64-bit number a splat, depth above index: no two are equal, so any fast sort is a stable one. The bits of a
    # positive float32 sort like the number itself.
    keys = (depths[visible].view(np.uint32).astype(np.uint64) << np.uint64(32)) | visible.astype(np.uint64)
    keys.sort()
    return (keys & np.uint64(0xFFFFFFFF)).astype(np.int64)


@numba.njit(parallel=True, cache=True)
@no_type_check
def _gathered(shapes, colors, order):
    sorted_shapes = np.empty((len(order), 8), np.float32)
    sorted_colors = np.empty((len(order), 4), np.float32)
    for n in numba.prange(len(order)):
        sorted_shapes[n] = shapes[order[n]]
        sorted_colors[n] = colors[order[n]]
    return sorted_shapes, sorted_colors


@numba.njit(parallel=True, cache=True, error_model="numpy")
@no_type_check
def _project_part(
    means, scales, quaternions, opacities, sh, rain, object_to_camera, eye, intrinsics, depths, shapes, colors
):  # fmt: skip
    """Fill depths (0: left out), shapes and colours of one part. Scalars are float64: 1e12 m squared still fits."""
    chunk_size = 512
    for chunk in numba.prange((len(means) + chunk_size - 1) // chunk_size):
        basis = np.empty(16, np.float32)
        for i in range(chunk * chunk_size, min(len(means), (chunk + 1) * chunk_size)):
            is_rain = len(rain) > 0 and rain[i]
            depth = _shape(
                means[i], scales[i], quaternions[i], opacities[i], is_rain, object_to_camera, intrinsics, shapes[i]
            )
            if depth > 0 and _color(means[i], sh[i], eye, basis, colors[i]):
                colors[i, 3] = depth
                depths[i] = depth


@numba.njit(error_model="numpy")
@no_type_check
def _shape(mean, scale, q, opacity, is_rain, m, intrinsics, shape):
    """Write one splat's shape; return its depth in metres, or 0 where it is not to be drawn."""
    fx, fy, cx, cy, width, height = intrinsics
    px = m[0, 0] * mean[0] + m[0, 1] * mean[1] + m[0, 2] * mean[2] + m[0, 3]
    py = m[1, 0] * mean[0] + m[1, 1] * mean[1] + m[1, 2] * mean[2] + m[1, 3]
    pz = m[2, 0] * mean[0] + m[2, 1] * mean[1] + m[2, 2] * mean[2] + m[2, 3]
    if not (NEAR_M < pz < 3e38):  # also drops NaN
        return 0.0

    # Local affine approximation of the projection, held back at 1.3 times the field of view.
    margin_x, margin_y = 0.15 * width / fx, 0.15 * height / fy
    slope_x = min(max(px / pz, -cx / fx - margin_x), (width - cx) / fx + margin_x)
    slope_y = min(max(py / pz, -cy / fy - margin_y), (height - cy) / fy + margin_y)
    w, x, y, z = np.float64(q[0]), np.float64(q[1]), np.float64(q[2]), np.float64(q[3])
    axes = (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )
    xx = xy = yy = 0.0
    for k in range(3):
        ax, ay, az = axes[k]
        s = scale[k]
        ex = s * (m[0, 0] * ax + m[0, 1] * ay + m[0, 2] * az)
        ey = s * (m[1, 0] * ax + m[1, 1] * ay + m[1, 2] * az)
        ez = s * (m[2, 0] * ax + m[2, 1] * ay + m[2, 2] * az)
        u, v = fx / pz * (ex - slope_x * ez), fy / pz * (ey - slope_y * ez)
        xx += u * u
        xy += u * v
        yy += v * v

    before = max(xx * yy - xy * xy, 0.0)
    xx += DILATION_PX2
    yy += DILATION_PX2
    determinant = xx * yy - xy * xy
    if not (0 < determinant < np.inf):
        return 0.0
    alpha = min(np.float64(opacity), 1.0)
    cut = SCENE_ALPHA_CUT
    if is_rain:
        alpha *= np.sqrt(before / determinant)
        cut = RAIN_ALPHA_CUT
    if not (alpha > cut):
        return 0.0
    log_alpha, log_cut = np.log(alpha), np.log(cut)
    extent = np.sqrt(2 * (log_alpha - log_cut))  # exact: alpha is the cut at the edge
    u, v = fx * px / pz + cx, fy * py / pz + cy
    reach_x, reach_y = extent * np.sqrt(xx), extent * np.sqrt(yy)
    if not (u + reach_x > 0 and u - reach_x < width and v + reach_y > 0 and v - reach_y < height):
        return 0.0
    shape[0], shape[1] = u, v
    shape[2] = xy / yy
    shape[3] = -0.5 * yy / determinant
    shape[4] = -0.5 / yy
    shape[5], shape[6] = log_alpha, log_cut
    shape[7] = reach_y
    return pz


@numba.njit(error_model="numpy")
@no_type_check
def _color(mean, sh, eye, basis, color):
    """Write the display colour, max(0, sum of harmonics + 0.5); return whether it is finite."""
    x, y, z = mean[0] - eye[0], mean[1] - eye[1], mean[2] - eye[2]
    length = np.sqrt(x * x + y * y + z * z)
    coefficients = sh.shape[0]
    sh_basis(np.float32(x / length), np.float32(y / length), np.float32(z / length), coefficients, basis)
    for channel in range(3):
        value = np.float32(0.5)
        for k in range(coefficients):
            value += basis[k] * sh[k, channel]
        if not np.isfinite(value):
            return False
        color[channel] = max(value, np.float32(0))
    return True
