"""How high the road lies in a vehicle's frame, from what its lidar saw close by."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

_NEAR_M, _LANE_M, _OWN_LENGTH_M, _OWN_WIDTH_M = 15.0, 4.0, 2.0, 1.2
_SLACK_M, _BIN_M, _LEAST = 1.0, 0.05, 50


def road_height(clouds: Iterable[Float[np.ndarray, "_ 3"]], expected_m: float) -> float:
    """Height (m) of the road under the vehicle's origin, in the vehicle's frame (x forward, y left, z up).

    `clouds` are points of some sweeps in that frame, `expected_m` what the data set says. A plane is fitted to the
    lowest well-filled layer within 15 m and the width of a lane (beside it are kerbs), and read off below the origin.
    Where too few points lie within 1 m of the expected height, that is the answer.
    """
    near = [_near_road(cloud, expected_m) for cloud in clouds]
    points = np.concatenate(near) if near else np.zeros((0, 3))
    if len(points) < _LEAST:
        return expected_m
    count, edges = np.histogram(points[:, 2], np.arange(-_SLACK_M, _SLACK_M + _BIN_M, _BIN_M) + expected_m)
    layer = edges[int(np.argmax(count >= 0.5 * count.max()))] + _BIN_M
    design = np.column_stack([np.ones(len(points)), points[:, :2]])
    plane, width = np.array([layer, 0.0, 0.0]), 0.3
    for _ in range(4):
        inside = np.abs(points[:, 2] - design @ plane) < width
        if np.count_nonzero(inside) < _LEAST:
            break
        plane = np.linalg.lstsq(design[inside], points[inside, 2], rcond=None)[0]
        width = max(width / 1.5, 0.1)
    return float(np.clip(plane[0], expected_m - _SLACK_M, expected_m + _SLACK_M))


def _near_road(cloud: Float[np.ndarray, "p 3"], expected_m: float) -> Float[np.ndarray, "q 3"]:
    flat = np.abs(cloud[:, :2])
    near = (flat[:, 0] < _NEAR_M) & (flat[:, 1] < _LANE_M) & (np.abs(cloud[:, 2] - expected_m) < _SLACK_M)
    own = (flat[:, 0] < _OWN_LENGTH_M) & (flat[:, 1] < _OWN_WIDTH_M)
    return np.asarray(cloud[near & ~own], np.float64)
