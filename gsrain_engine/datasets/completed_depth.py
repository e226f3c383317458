"""Completion of sparse depth maps, so that every pixel below the sky has an initial surface."""

import numpy as np
from jaxtyping import Bool, Float32, Float64
from scipy.ndimage import distance_transform_edt, minimum_filter1d
from scipy.spatial import Delaunay, QhullError

_LARGEST_RATIO = 1.25  # maximum ratio of the depths of a triangle's corners on one surface
_LONGEST_EDGE = 0.12  # maximum edge of a valid triangle, as a fraction of the image width
_FOOT = 0.12  # fraction of the rows above the lowest depth that determine the plane continued below it


def completed_depth(
    sparse_m: Float32[np.ndarray, "h w"],
    sky: Bool[np.ndarray, "h w"] | None = None,
    road_m: Float32[np.ndarray, "h w"] | None = None,
) -> Float32[np.ndarray, "h w"]:
    """Depth along the view axis at all pixels but the sky's, in the unit of `sparse_m`; 0 if undetermined.

    Inverse depth is interpolated linearly over Delaunay triangles, which is exact on planes; triangles that bridge two
    surfaces take the nearest point. Below the lowest points the road plane is continued; above the highest, surfaces
    are assumed to be upright, with the depth of the point below.

    Args:
        sparse_m: Measured depth, 0 if unknown.
        sky: Pixels that have no depth.
        road_m: Depth of the road in each pixel if known better than from this view's measurements (see
            `road_depth`); it limits all extrapolated depths.
    """
    rows, columns = np.nonzero(sparse_m > 0)
    if len(rows) < 3:
        return np.zeros_like(sparse_m)
    depth, told = _between(sparse_m, rows, columns)
    if road_m is None:
        depth = _above(_below(depth))
    else:
        depth = _above(depth)
        depth = np.where(told, depth, np.minimum(depth, road_m))
    if sky is not None:
        depth[sky] = 0
    return depth


def _between(
    sparse: Float32[np.ndarray, "h w"], rows: np.ndarray, columns: np.ndarray
) -> tuple[Float32[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Depth inside the mesh of the measured pixels, 0 elsewhere; and a mask of pixels interpolated on one surface."""
    height, width = sparse.shape
    values = sparse[rows, columns].astype(np.float64)
    corners = np.stack([columns, rows], axis=1).astype(np.float64)
    try:
        mesh = Delaunay(corners)
    except QhullError:  # all points on one line
        return sparse.copy(), sparse > 0
    at = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(np.float64)
    triangle = mesh.find_simplex(at)
    inside = np.flatnonzero(triangle >= 0)
    believed, reaches = _believed(mesh, values, _LONGEST_EDGE * width)
    tri = triangle[inside]
    members = mesh.simplices[tri]
    weights = _barycentric(mesh, tri, at[inside])
    linear = 1 / np.maximum((weights / values[members]).sum(axis=1), 1e-9)
    nearest = values[members[np.arange(len(tri)), weights.argmax(axis=1)]]
    depth = np.zeros(height * width)
    depth[inside] = np.where(believed[tri], linear, np.where(reaches[tri], nearest, 0))
    told = np.zeros(height * width, np.bool_)
    told[inside] = believed[tri]
    return depth.reshape(height, width).astype(np.float32), told.reshape(height, width)


def _believed(
    mesh: Delaunay, values: Float64[np.ndarray, " p"], longest: float
) -> tuple[Bool[np.ndarray, " t"], Bool[np.ndarray, " t"]]:
    """Masks of triangles on one surface, and of triangles small enough to be used."""
    corners, depths = mesh.points[mesh.simplices], values[mesh.simplices]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    reaches = edges <= longest
    return reaches & (depths.max(axis=1) <= _LARGEST_RATIO * depths.min(axis=1)), reaches


def _barycentric(mesh: Delaunay, triangle: np.ndarray, at: Float64[np.ndarray, "p 2"]) -> Float64[np.ndarray, "p 3"]:
    turn = mesh.transform[triangle]
    first = np.einsum("pij,pj->pi", turn[:, :2], at - turn[:, 2])
    return np.clip(np.concatenate([first, 1 - first.sum(axis=1, keepdims=True)], axis=1), 0, 1)


def _below(depth: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Continue the plane of the lowest measured rows, fitted over the whole width, to the lower edge."""
    height, width = depth.shape
    known = depth > 0
    lowest = np.where(known.any(axis=0), height - 1 - known[::-1].argmax(axis=0), -1)
    row = np.arange(height)[:, None]
    near_foot = known & (row > lowest[None, :] - _FOOT * height)
    if near_foot.sum() < 30:
        return depth
    v, u = np.nonzero(near_foot)
    system = np.stack([u / width, v / height, np.ones(len(u))], axis=1)
    inverse = 1.0 / depth[v, u]
    use, plane = np.ones(len(u), np.bool_), np.zeros(3)
    for _ in range(4):  # rejects objects on the road
        plane = np.linalg.lstsq(system[use], inverse[use], rcond=None)[0]
        residual = np.abs(system @ plane - inverse)
        use = residual <= max(2.0 * float(np.median(residual[use])), 1e-6)
    if plane[1] <= 0:  # not a ground plane, whose depth decreases downward
        return depth
    whole = plane[0] * np.arange(width)[None, :] / width + plane[1] * row / height + plane[2]
    fill = ~known & (row > lowest[None, :]) & (whole > inverse.min())
    return np.where(fill, 1 / np.where(fill, whole, 1), depth).astype(np.float32)


def _above(depth: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Extend the highest depth of each column upright to the upper edge; gaps take the nearest known depth."""
    height, width = depth.shape
    known = depth > 0
    if not known.any():
        return depth
    top = np.where(known.any(axis=0), known.argmax(axis=0), height)
    at_top = np.where(top < height, depth[np.minimum(top, height - 1), np.arange(width)], np.inf)
    at_top = minimum_filter1d(at_top, max(width // 60, 3))
    upright = np.broadcast_to(at_top.astype(np.float32), depth.shape)
    is_above = (np.arange(height)[:, None] < top[None, :]) & np.isfinite(upright)
    filled = np.where(is_above & ~known, upright, depth)
    nearest = np.asarray(distance_transform_edt(filled <= 0, return_distances=False, return_indices=True))
    return filled[nearest[0], nearest[1]].astype(np.float32)
