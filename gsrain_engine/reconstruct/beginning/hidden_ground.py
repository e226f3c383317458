"""The road that no picture shows, because the ego's own body hid it: what lies around it is carried on."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Float64
from scipy.spatial import KDTree

from gsrain_engine.datasets.capture import View
from gsrain_engine.datasets.pixels.road_plane import road_drop
from gsrain_engine.scene.gaussians import Gaussians
from gsrain_engine.scene.rotations import quaternions_from_matrices

_REACH = 3.5
"""How far around the cameras the road is carried on, over their height above it: the length of a car."""
_FLAT = 0.25
"""Most height over and under the road, over that of the cameras, of what belongs to it."""
_SPACING, _COARSEST = 0.06, 0.25
"""Of the new discs, over the height of the cameras: some 9 cm, and 40 at most."""
_SIGMA, _THICKNESS = 0.7, 0.05
"""Of a disc along the road and across it, over the spacing."""
_COVERS = 2.0
"""So many of its standard deviations around a disc there is no hole."""
_NEIGHBOURS = 12
_LEAST_ROAD = 100


def hidden_ground(
    surface: Gaussians,
    views: Sequence[View],
    way: Float64[np.ndarray, "p 3"],
    up: tuple[float, float, float],
    most: int,
    opacity: float,
) -> Gaussians:
    """Discs where the road under and around the cameras has holes, in the height and colour of the road next to them.

    Args:
        surface: Of the static scene, in the capture's world; the road is what lies flat and low in it.
        views: Whose cameras drove over that road.
        way: Where the cameras went, see `camera_way`.
        up: Upward direction.
        most: Number of discs; where that is too few, they are larger, and where they are too large there are none.
        opacity: Of the discs.

    Returns:
        None at all where no road is found under the cameras.
    """
    frame = _frame(up)
    drop = road_drop(surface.means.astype(np.float64), views, up) if len(surface) else None
    if drop is None:
        return surface.take(slice(0, 0))
    way = way @ frame.T
    places = surface.means.astype(np.float64) @ frame.T
    distance, nearest = KDTree(way[:, :2]).query(places[:, :2])
    is_road = (distance < 3 * _REACH * drop) & (np.abs(way[nearest, 2] - drop - places[:, 2]) < _FLAT * drop)
    road = surface.take(np.flatnonzero(is_road))
    if len(road) < _LEAST_ROAD:
        return surface.take(slice(0, 0))
    known = places[is_road]
    tree = KDTree(known[:, :2])
    covered = np.sqrt(np.sort(road.scales, axis=1)[:, 1:].prod(axis=1)) * _COVERS
    spacing = _SPACING * drop
    while len(holes := _holes(way[:, :2], spacing, _REACH * drop, tree, covered)) > most and spacing < _COARSEST * drop:
        spacing *= 1.3
    if not 0 < len(holes) <= most:
        return surface.take(slice(0, 0))
    apart, neighbours = tree.query(holes, _NEIGHBOURS)
    weight = 1 / np.maximum(apart, spacing) ** 2
    weight /= weight.sum(axis=1, keepdims=True)
    heights = (weight * known[neighbours, 2]).sum(axis=1)
    turn = quaternions_from_matrices(frame.T * [1, 1, np.sign(np.linalg.det(frame))])
    return Gaussians(
        (np.column_stack([holes, heights]) @ frame).astype(np.float32),
        np.tile((np.array([_SIGMA, _SIGMA, _THICKNESS]) * spacing).astype(np.float32), (len(holes), 1)),
        np.tile(turn.astype(np.float32), (len(holes), 1)),
        np.full(len(holes), opacity, np.float32),
        np.einsum("nm,nmkc->nkc", weight, road.sh[neighbours]).astype(np.float32),
    )


def _frame(up: tuple[float, float, float]) -> Float64[np.ndarray, "3 3"]:
    """Rows: two level directions and the upward one."""
    axis = np.array(up, np.float64) / np.linalg.norm(up)
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(axis, side), axis])


def _holes(
    way: Float64[np.ndarray, "p 2"], spacing: float, reach: float, road: KDTree, covered: Float32[np.ndarray, " r"]
) -> Float64[np.ndarray, "h 2"]:
    """Places of a grid near the way that no piece of road covers."""
    low, high = way.min(axis=0) - reach, way.max(axis=0) + reach
    axes = [np.arange(low[k], high[k], spacing) for k in range(2)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    grid = grid[np.isfinite(KDTree(way).query(grid, distance_upper_bound=reach)[0])]
    apart, nearest = road.query(grid)
    return grid[apart > np.maximum(covered[nearest], spacing)]
