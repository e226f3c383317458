"""Glossy reflection of rough water: microfacets of all slopes with Fresnel's law. World frame, linear light."""

from typing import NamedTuple, no_type_check

import cv2
import numba
import numpy as np
from jaxtyping import Float32, Float64, Int64

from ...kernels import kernel, range_of
from ...scene.water_surface import WATER_INDEX, reflectance, unshadowed
from ..base import Image, Plane
from .reflections import PlanarReflection, focal_and_center

_WIDEST = 2.2  # largest facet tilt that is integrated, in standard deviations
_FAR_M = 1000.0  # distance of the sky
_ROUNDS = 3
_ACROSS = 2.0  # width of the sideways blur of the mirror image, in standard deviations of the effect of sideways tilts
_SPECK_PX = 5  # width of the median filter that removes single pixels


class GlossyReflection(NamedTuple):
    """Light that the water surface reflects towards the eye."""

    color: Image
    """Linear light, multiplied by its share."""
    share: Plane
    """Share of light reflected towards the eye, 0..1."""


class Ripmap(NamedTuple):
    """Images of halving sizes, stored consecutively (a "ripmap", McReynolds et al. 1998).

    They are blurred by powers of two, separately across and down, because rough reflections are stretched.
    """

    values: Float32[np.ndarray, " n"]
    """All images, as rows of three channels."""
    table: Int64[np.ndarray, "down across 3"]
    """Offset of each image in `values`, its rows and columns."""


def glossy_reflection(
    mirrored: PlanarReflection,
    picture: Ripmap,
    eye: Float64[np.ndarray, "3"],
    points_m: Float64[np.ndarray, "h w 3"],
    normals: Image,
    slopes: Plane,
    facets: int,
) -> GlossyReflection:
    """Integrate the light that the facets of a rough water surface reflect towards the eye.

    Facets tilted towards and away from the eye, with Gaussian slopes, are weighted by their projected area; each
    reflects by Fresnel's law, reduced by shadowing (Smith 1967). Mirrored rays end at the mirror image's depth.
    Facets tilted sideways blur across; at grazing angles this is much less than the vertical blur of the others, which
    is why reflections on wet roads are stretched. Both blurs are zero at the foot of an object and grow with distance.
    Pixels with a slope below 0 are left out.
    """
    size = slopes.shape
    color, share = np.zeros((*size, 3), np.float32), np.zeros(size, np.float32)
    camera = mirrored.beyond.camera
    _integrate(
        points_m, normals, slopes, eye, camera.world_to_camera, focal_and_center(camera), mirrored.depth,
        picture.values, picture.table, facets, color, share,
    )  # fmt: skip
    mean = color / np.maximum(share, np.float32(1e-6))[..., None]
    # Remove single pixels at object edges whose rays hit another object than their neighbors' rays.
    window = np.ones((_SPECK_PX, _SPECK_PX), np.uint8)
    inner = cv2.erode((slopes >= 0).astype(np.uint8), window, borderValue=1)
    mean = np.where(inner[..., None] > 0, cv2.medianBlur(mean, _SPECK_PX), mean)
    return GlossyReflection(share[..., None] * mean, share)


@kernel(parallel=True, error_model="numpy")
@no_type_check
def _integrate(portion, points, normals, slopes, eye, pose, lens, depth, values, table, facets, color, share):
    height, width = slopes.shape
    half = facets // 2
    for v in range_of(portion, height):
        for u in range(width):
            slope = slopes[v, u]
            if slope < 0:
                continue
            px, py, pz = points[v, u, 0], points[v, u, 1], points[v, u, 2]
            nx, ny, nz = normals[v, u, 0], normals[v, u, 1], normals[v, u, 2]
            ex, ey, ez = eye[0] - px, eye[1] - py, eye[2] - pz
            eye_distance = np.sqrt(ex * ex + ey * ey + ez * ez)
            ex, ey, ez = ex / eye_distance, ey / eye_distance, ez / eye_distance
            flat = ex * nx + ey * ny + ez * nz
            if not flat > 1e-3:  # also excludes NaN
                continue
            tx, ty, tz = ex - flat * nx, ey - flat * ny, ez - flat * nz  # along the ground, towards the eye
            length = max(np.sqrt(tx * tx + ty * ty + tz * tz), 1e-6)
            tx, ty, tz = tx / length, ty / length, tz / length
            step = slope * _WIDEST / max(half, 1)
            seen = mirrored = red = green = blue = 0.0
            middle = _FAR_M
            for side in range(2):
                reach = middle
                for k in range(side, half + 1):
                    tilt = step * (k if side == 0 else -k)
                    norm = 1 / np.sqrt(1 + tilt * tilt)
                    mx, my, mz = (nx + tilt * tx) * norm, (ny + tilt * ty) * norm, (nz + tilt * tz) * norm
                    cosine = ex * mx + ey * my + ez * mz
                    if cosine <= 0:
                        continue
                    weight = np.exp(-0.5 * (tilt / slope) ** 2) * cosine / norm if slope > 0 else 1.0
                    seen += weight
                    rx, ry, rz = 2 * cosine * mx - ex, 2 * cosine * my - ey, 2 * cosine * mz - ez
                    rise = rx * nx + ry * ny + rz * nz
                    if rise <= 0:
                        continue
                    weight *= reflectance(cosine, WATER_INDEX) * unshadowed(rise, slope)
                    qx = qy = 0.0
                    for _ in range(_ROUNDS if k == 0 else 2):
                        x, y, z = px + reach * rx, py + reach * ry, pz + reach * rz
                        qz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
                        if not qz > 0.05:
                            break
                        qx = (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / qz * lens[0] + lens[2]
                        qy = (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / qz * lens[1] + lens[3]
                        found = depth[
                            min(max(int(qy), 0), depth.shape[0] - 1), min(max(int(qx), 0), depth.shape[1] - 1)
                        ]
                        start = pose[2, 0] * px + pose[2, 1] * py + pose[2, 2] * pz + pose[2, 3]
                        along = pose[2, 0] * rx + pose[2, 1] * ry + pose[2, 2] * rz
                        reach = _FAR_M
                        if found > 0:
                            reach = min(max((found - start) / max(along, 0.05), 0.05), _FAR_M)
                    if k == 0:
                        middle = reach
                    parallax = 2 * reach / (reach + eye_distance)
                    down = parallax * max(step, 0.25 * slope) * lens[1]
                    across = parallax * _ACROSS * slope * flat * lens[0]
                    r, g, b = _looked_up(values, table, qx, qy, down, across)
                    red, green, blue, mirrored = (
                        red + weight * r, green + weight * g, blue + weight * b, mirrored + weight,
                    )  # fmt: skip
            if seen > 0:
                color[v, u, 0], color[v, u, 1], color[v, u, 2] = red / seen, green / seen, blue / seen
                share[v, u] = mirrored / seen


@numba.njit(error_model="numpy")
@no_type_check
def _looked_up(values, table, x, y, down_px, across_px):
    """Color at a position, averaged over a number of pixels down and across."""
    i = min(max(0.0, np.log2(max(down_px, 1.0))), table.shape[0] - 1.001)
    j = min(max(0.0, np.log2(max(across_px, 1.0))), table.shape[1] - 1.001)
    i0, j0 = int(i), int(j)
    red = green = blue = 0.0
    for di in range(2):
        share_i = i - i0 if di else 1 - i + i0
        for dj in range(2):
            share = share_i * (j - j0 if dj else 1 - j + j0)
            if share < 1e-3:
                continue
            start, rows, columns = table[i0 + di, j0 + dj, 0], table[i0 + di, j0 + dj, 1], table[i0 + di, j0 + dj, 2]
            sx = min(max(0.0, x * columns / table[0, 0, 2] - 0.5), columns - 1.0)
            sy = min(max(0.0, y * rows / table[0, 0, 1] - 0.5), rows - 1.0)
            x0, y0 = min(int(sx), max(columns - 2, 0)), min(int(sy), max(rows - 2, 0))
            fx, fy = share * (sx - x0), sy - y0
            right, under = (3 if columns > 1 else 0), (3 * columns if rows > 1 else 0)
            at = start + 3 * (y0 * columns + x0)
            w00, w01, w10, w11 = (share - fx) * (1 - fy), fx * (1 - fy), (share - fx) * fy, fx * fy
            below = at + under
            red += w00 * values[at] + w01 * values[at + right] + w10 * values[below] + w11 * values[below + right]
            at, below = at + 1, below + 1
            green += w00 * values[at] + w01 * values[at + right] + w10 * values[below] + w11 * values[below + right]
            at, below = at + 1, below + 1
            blue += w00 * values[at] + w01 * values[at + right] + w10 * values[below] + w11 * values[below + right]
    return red, green, blue


_SAMPLES_DOWN, _SAMPLES_ACROSS = 8, 5


def build_ripmap(image: Image) -> Ripmap:
    """Repeatedly halve an image (linear light) down and across."""
    pieces, table = list[Float32[np.ndarray, " n"]](), np.zeros((_SAMPLES_DOWN, _SAMPLES_ACROSS, 3), np.int64)
    start, tall = 0, np.ascontiguousarray(image)
    for down in range(_SAMPLES_DOWN):
        wide = tall
        for across in range(_SAMPLES_ACROSS):
            table[down, across] = start, wide.shape[0], wide.shape[1]
            pieces.append(wide.ravel())
            start += wide.size
            wide = cv2.resize(wide, (max(wide.shape[1] // 2, 1), wide.shape[0]), interpolation=cv2.INTER_AREA)
        tall = cv2.resize(tall, (tall.shape[1], max(tall.shape[0] // 2, 1)), interpolation=cv2.INTER_AREA)
    return Ripmap(np.concatenate(pieces), table)
