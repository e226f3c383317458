"""Corners and edges of a box, and what of them lies before a camera."""

import numpy as np
from jaxtyping import Float64

CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
"""Of a box of size 1: x forward, y left, z up, origin at the bottom centre."""
EDGES = np.array([(a, b) for a in range(8) for b in range(a) if (CORNERS[a] != CORNERS[b]).sum() == 1])
"""Numbers of the two corners of each."""
_NEAR_M = 0.1


def box_corners(
    pose: Float64[np.ndarray, "4 4"], size_lwh_m: tuple[float, float, float] | Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "8 3"]:
    """Corners of a box (length, width and height in metres) in the frame that its pose leads to, in metres."""
    return (CORNERS * size_lwh_m) @ pose[:3, :3].T + pose[:3, 3]


def before_camera(corners: Float64[np.ndarray, "8 3"]) -> Float64[np.ndarray, "c 3"]:
    """Corners of a box in a camera's frame (OpenCV axes, metres), cut off where it reaches behind the camera."""
    start, end = corners[EDGES[:, 0]], corners[EDGES[:, 1]]
    crosses = (start[:, 2] > _NEAR_M) != (end[:, 2] > _NEAR_M)
    start, end = start[crosses], end[crosses]
    part = ((_NEAR_M - start[:, 2]) / (end[:, 2] - start[:, 2]))[:, None]
    return np.concatenate([corners[corners[:, 2] > _NEAR_M], start + part * (end - start)])
