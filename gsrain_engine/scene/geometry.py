"""Quaternions, the sRGB transfer function, and boxes.

Quaternions are (w, x, y, z), unit, right-handed, as in 3DGS files.
"""

from typing import Any

import numpy as np
from jaxtyping import Float, Float64


def normalized(quaternions: Float[np.ndarray, "*n 4"]) -> Float[np.ndarray, "*n 4"]:
    return quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)


def matrices_from_quaternions(quaternions_wxyz: Float[np.ndarray, "*n 4"]) -> Float[np.ndarray, "*n 3 3"]:
    """Convert unit quaternions to rotation matrices that act on column vectors."""
    is_single = quaternions_wxyz.shape == (4,) and quaternions_wxyz.dtype == np.float64
    w, x, y, z = quaternions_wxyz.tolist() if is_single else np.moveaxis(quaternions_wxyz, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    if is_single:  # of a pose: arrays of one number take 20 times as long
        return np.array(rows)
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternions_from_matrices(rotations: Float[np.ndarray, "*n 3 3"]) -> Float[np.ndarray, "*n 4"]:
    """Convert rotation matrices to unit quaternions (w, x, y, z) with w >= 0."""
    m = rotations
    # Four candidates, each exact if its own diagonal term is the largest (Shepperd, 1978).
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    squares = np.stack([trace, m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]], axis=-1)
    a, b, c = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    d, e, f = m[..., 1, 0] + m[..., 0, 1], m[..., 0, 2] + m[..., 2, 0], m[..., 2, 1] + m[..., 1, 2]
    candidates = np.stack(
        [
            np.stack([1 + trace, a, b, c], axis=-1),
            np.stack([a, 1 + 2 * m[..., 0, 0] - trace, d, e], axis=-1),
            np.stack([b, d, 1 + 2 * m[..., 1, 1] - trace, f], axis=-1),
            np.stack([c, e, f, 1 + 2 * m[..., 2, 2] - trace], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(squares, axis=-1)[..., None, None]
    quaternions = np.take_along_axis(candidates, best, axis=-2)[..., 0, :]
    quaternions = normalized(quaternions)
    return np.where(quaternions[..., :1] < 0, -quaternions, quaternions)


def quaternion_product(left: Float[np.ndarray, "*n 4"], right: Float[np.ndarray, "*n 4"]) -> Float[np.ndarray, "*n 4"]:
    """Compose rotations: first `right`, then `left`."""
    w1, x1, y1, z1 = np.moveaxis(left, -1, 0)
    w2, x2, y2, z2 = np.moveaxis(right, -1, 0)
    return np.stack(
        [
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ],
        axis=-1,
    )


def rotation_about_z(degrees: float) -> Float[np.ndarray, "3 3"]:
    """Counter-clockwise as viewed from above."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


# sRGB transfer function (IEC 61966-2-1)


LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear red, green and blue in luminance (ITU-R BT.709)."""


def srgb_to_linear(display: Float[np.ndarray, "*n"]) -> Float[Any, "*n"]:
    """Convert display values to linear light; both are 1 for white. Values below 0 count as 0."""
    c = np.maximum(display, 0)
    return np.where(c > 0.04045, ((c + 0.055) / 1.055) ** 2.4, c / 12.92)


def linear_to_srgb(linear: Float[np.ndarray, "*n"]) -> Float[Any, "*n"]:
    """Convert linear light to display values; both are 1 for white. Values below 0 count as 0."""
    c = np.maximum(linear, 0)
    return np.where(c > 0.0031308, 1.055 * c ** (1 / 2.4) - 0.055, 12.92 * c)


# Boxes

CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
"""Corners of a unit box: x forward, y left, z up, origin at the bottom center."""

EDGES = np.array([(a, b) for a in range(8) for b in range(a) if (CORNERS[a] != CORNERS[b]).sum() == 1])
"""Pairs of corner indices."""

_NEAR_M = 0.1


def box_corners(
    pose: Float64[np.ndarray, "4 4"], size_lwh_m: tuple[float, float, float] | Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "8 3"]:
    """Corners of a box (length, width and height in meters), transformed by its pose, in meters."""
    return (CORNERS * size_lwh_m) @ pose[:3, :3].T + pose[:3, 3]


def before_camera(corners: Float64[np.ndarray, "8 3"]) -> Float64[np.ndarray, "c 3"]:
    """Corners of a box in a camera's frame (OpenCV axes, meters), clipped at the near plane."""
    start, end = corners[EDGES[:, 0]], corners[EDGES[:, 1]]
    crosses = (start[:, 2] > _NEAR_M) != (end[:, 2] > _NEAR_M)
    start, end = start[crosses], end[crosses]
    part = ((_NEAR_M - start[:, 2]) / (end[:, 2] - start[:, 2]))[:, None]
    return np.concatenate([corners[corners[:, 2] > _NEAR_M], start + part * (end - start)])
