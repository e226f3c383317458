"""Refinement of quads for sharp pictures: small cells at color edges, outlines and shadows, where the ego passes close.

The front camera of the ego on its way decides: a cell at an edge has about the size of a pixel where it is closest, and
its neighbors grow away from the edge. Surfaces of one color need few large cells.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float64, Int64, UInt64

from .layout import Label, StreetParameters
from .lighting import Illumination
from .mesh import EDGE_SPREAD, INNER_SPREAD, Quads, geometric_normals

GROWTH = 2.0
"""Ratio of a cell's width to that of its neighbor nearer to the edge."""

_CLEAR_DEVIATIONS = 2.4  # minimum distance from a Gaussian's center to the next edge but one, in standard deviations
_MAX_CELLS = 9
_HIDDEN = 4.0  # factor on the cells of surfaces that the front camera does not see: other cameras do
_LEAF = 3.0  # the same for leaves, which are many
_LEAF_SMOOTH = 1.12  # gaussians of leaves are this much wider than elsewhere: gaps would let the sky through
_CONTRAST = 0.05  # minimum difference of display color at an edge
_SAME_M = 1e-3  # corners nearer than this are one

# The front camera
_FOCAL_PX = 1030.0  # of the front camera of `waymo_front3` at a width of 960 px
_SLOPES = 0.4663, 0.311  # of its field of view to the sides, and up and down
_AHEAD_M, _HEIGHT_M = 1.54, 2.12
_NEAREST_M = 3.0
_FARTHER = 1.0, 2.0, 6.0  # distances from which outlines are those of a surface, relative to the closest


class CameraLine(NamedTuple):
    """Straight line along +x on which a camera moves that looks along it, in meters."""

    first_x: float
    last_x: float
    y: float
    z: float


def ego_camera_line(p: StreetParameters) -> CameraLine:
    """Line of the ego's front camera through the street."""
    return CameraLine(_AHEAD_M, _AHEAD_M + p.ego_speed_m_s * p.drive_seconds, -0.5 * p.lane_width_m, _HEIGHT_M)


_VEHICLE_PX = 1.0


def refined_vehicle(quads: Quads) -> Quads:
    """Cut a vehicle in its own frame for the camera of a follower, who sees its rear."""
    return refined(quads, _FOLLOWING, _VEHICLE_PX)


_FOLLOWING = CameraLine(_AHEAD_M - 18.0, _AHEAD_M - 15.5, 0.0, _HEIGHT_M)
"""Line of the camera of a follower, in the frame of a vehicle."""


def refined(quads: Quads, line: CameraLine, edge_px: float) -> Quads:
    """Cut quads next to color edges and outlines into cells of `edge_px` that double with each step away from them.

    Translucent quads stay as they are, in their place.
    """
    if not len(quads):
        return quads
    lengths, facing = _view(quads, line)
    hard = _hard_edges(quads, facing) & (quads.opacity > 0.9)[:, None]
    leaf = _is_leaf(quads)
    steps = edge_px * np.where(leaf, _LEAF, np.where(facing.any(axis=1), 1.0, _HIDDEN))
    # Rows: number of cells along u and v, hard ends along u and v (2 the first, 1 the last, 3 both).
    ends = np.stack([2 * hard[:, 3] + hard[:, 1], 2 * hard[:, 0] + hard[:, 2]], axis=1)
    counts = np.stack([_cell_count(lengths[:, k] / steps, ends[:, k]) for k in (0, 1)], axis=1)
    number = counts[:, 0] * counts[:, 1]
    first = np.cumsum(number) - number
    corners, spread = np.empty((int(number.sum()), 4, 3), np.float32), np.empty((int(number.sum()), 2), np.float32)
    kinds, kind_of = np.unique(np.concatenate([counts, ends], axis=1), axis=0, return_inverse=True)
    order = np.argsort(kind_of.reshape(-1), kind="stable")
    for kind, own in zip(kinds, np.split(order, np.cumsum(np.bincount(kind_of.reshape(-1)))[:-1]), strict=True):
        i, j, at_u, at_v = (int(each) for each in kind)
        rows = (first[own, None] + np.arange(i * j)).reshape(-1)
        u, v = _graded(i, at_u), _graded(j, at_v)
        corners[rows] = _cells(quads.corners[own], u, v)
        each = np.empty((len(own), i, j, 2), np.float32)
        each[...] = quads.spread[own, None, None]
        if i * j > 1:  # otherwise the quad knows better: single ones have their own spread
            each[..., 0] = _spreads(u, at_u)[:, None] if at_u else each[..., 0]
            each[..., 1] = _spreads(v, at_v) if at_v else each[..., 1]
        spread[rows] = each.reshape(-1, 2)
    cells = quads.take(np.repeat(np.arange(len(quads)), number))
    spread[_is_leaf(cells)] *= _LEAF_SMOOTH
    return replace(cells, corners=corners, spread=spread)


def _is_leaf(quads: Quads) -> Bool[np.ndarray, " n"]:
    return (quads.labels == Label.VEGETATION) & (quads.opacity < 0.99)


def _cell_count(length: Float64[np.ndarray, " n"], ends: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Number of cells along sides of a length in cells at the edge: 1 + G + G^2 + ... from each hard end."""
    both = ends == 3
    steps = np.log1p(np.where(both, 0.5, 1.0) * length * (GROWTH - 1)) / np.log(GROWTH)
    count = np.clip(np.round(np.where(both, 2, 1) * steps), 1, _MAX_CELLS).astype(np.int64)
    return np.where(ends > 0, count, 1)


def _graded(count: int, ends: int) -> Float64[np.ndarray, " m"]:
    """Lines from 0 to 1 around cells that grow from the hard ends."""
    k = np.arange(count)
    from_end = {0: k, 1: k[::-1], 2: k, 3: np.minimum(k, k[::-1])}[ends]
    widths = GROWTH**from_end
    return np.concatenate([[0.0], np.cumsum(widths) / widths.sum()])


def _spreads(lines: Float64[np.ndarray, " m"], ends: int) -> Float64[np.ndarray, " n"]:
    """Standard deviations in cell widths: small enough that none reaches across the hard ends."""
    middle, widths = 0.5 * (lines[1:] + lines[:-1]), np.diff(lines)
    away = {1: 1 - middle, 2: middle, 3: np.minimum(middle, 1 - middle)}[ends]
    return np.clip(away / (_CLEAR_DEVIATIONS * widths), EDGE_SPREAD, INNER_SPREAD)


def _cells(
    corners: Float[np.ndarray, "n 4 3"], u: Float64[np.ndarray, " i"], v: Float64[np.ndarray, " j"]
) -> Float64[np.ndarray, "m 4 3"]:
    """Cells of quads between lines along u and v, bilinear; those of one quad follow each other, v fastest."""
    c = corners.astype(np.float64)[:, None, None]
    a, b = u[None, :, None, None], v[None, None, :, None]
    points = (1 - b) * ((1 - a) * c[..., 0, :] + a * c[..., 1, :]) + b * ((1 - a) * c[..., 3, :] + a * c[..., 2, :])
    around = points[:, :-1, :-1], points[:, 1:, :-1], points[:, 1:, 1:], points[:, :-1, 1:]
    return np.stack(around, axis=3).reshape(-1, 4, 3)


def _view(quads: Quads, line: CameraLine) -> tuple[Float64[np.ndarray, "n 2"], Bool[np.ndarray, "n 3"]]:
    """Lengths of u and v in px where the camera passes closest, and whether it sees the front, from three distances.

    A quad leaves the image at the depth where the line of sight to it has the slope of the field of view.
    """
    c = quads.corners.astype(np.float64)
    middle = c.mean(axis=1)
    aside, above = middle[:, 1] - line.y, middle[:, 2] - line.z
    closest = np.maximum(np.maximum(np.abs(aside) / _SLOPES[0], np.abs(above) / _SLOPES[1]), _NEAREST_M)
    depth = np.maximum(closest, middle[:, 0] - line.last_x)
    farthest = middle[:, 0] - line.first_x
    normals = geometric_normals(c)
    lengths = np.empty((len(quads), 2))
    for k, edge in enumerate((c[:, 1] + c[:, 2] - c[:, 0] - c[:, 3], c[:, 2] + c[:, 3] - c[:, 0] - c[:, 1])):
        across, up = edge[:, 1] - aside / depth * edge[:, 0], edge[:, 2] - above / depth * edge[:, 0]
        lengths[:, k] = 0.5 * _FOCAL_PX / depth * np.hypot(across, up)
    facing = np.empty((len(quads), len(_FARTHER)), np.bool_)
    for k, times in enumerate(_FARTHER):
        ahead = np.minimum(times * depth, np.maximum(farthest, depth))
        facing[:, k] = ahead * normals[:, 0] + aside * normals[:, 1] + above * normals[:, 2] < 0
    return lengths, facing & (farthest >= closest)[:, None]


# Edges


def _hard_edges(quads: Quads, facing: Bool[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n 4"]:
    """Sides (corners 0-1, 1-2, 2-3, 3-0) where the color changes, or an outline is: the surface ends, or turns away."""
    points = _hashed(np.round(quads.corners.astype(np.float64) / _SAME_M).astype(np.int64))
    following = np.roll(points, -1, axis=1)
    sides = (np.minimum(points, following) * np.uint64(3) + np.maximum(points, following)).reshape(-1)
    order = np.argsort(sides, kind="stable")
    same = np.flatnonzero(sides[order[1:]] == sides[order[:-1]])
    a, b = order[same], order[same + 1]
    colors, one, other = _tones(quads), a // 4, b // 4
    differs = np.max(np.abs(colors[one] - colors[other]), axis=1) > _CONTRAST
    differs |= (facing[one] != facing[other]).any(axis=1)
    hard = np.ones(len(sides), np.bool_)
    hard[a] = hard[b] = False
    hard[a] |= differs
    hard[b] |= differs
    return hard.reshape(-1, 4) & (points != following)


def _hashed(points: Int64[np.ndarray, "n 4 3"]) -> UInt64[np.ndarray, "n 4"]:
    """One number for each point (finished as in splitmix64)."""
    primes = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
    mixed = (points.view(np.uint64) * primes).sum(axis=2, dtype=np.uint64)
    for shift in (30, 27, 31):
        mixed = (mixed ^ (mixed >> np.uint64(shift))) * np.uint64(0xBF58476D1CE4E5B9)
    return mixed


_SUN = np.array([-0.42, 0.54, 0.73])


def _tones(quads: Quads) -> Float64[np.ndarray, "n 3"]:
    """Approximate display colors without shadows, to compare neighbors."""
    normals = quads.normals.astype(np.float64)
    light = 2.6 * (np.maximum(normals @ _SUN, 0) * quads.sun_access)[:, None]
    light = light + quads.sky_access[:, None] * (0.35 + 0.25 * normals[:, 2:])
    return (1 - np.exp(-1.2 * light * quads.albedo)) ** (1 / 2.2) + 0.3 * quads.gloss[:, None]


# Shadows

_SHADE_PX = 6.0  # size of the cells across a shadow's edge, which is soft
_SHADE_CONTRAST = 0.08
_MAX_SHADE_CELLS = 6


def split_at_shadows(quads: Quads, line: CameraLine, light: Illumination, edge_px: float) -> Quads:
    """Cut quads that the edge of a shadow cast by the sun crosses into even cells of six times `edge_px`."""
    lengths, facing = _view(quads, line)
    lit = np.maximum(quads.normals @ light.sun.astype(np.float32), 0) * quads.sun_access
    large = lengths.max(axis=1, initial=0) > 1.5 * _SHADE_PX * edge_px
    solid = (quads.labels != Label.VEGETATION) & (quads.opacity > 0.9)
    chosen = np.flatnonzero(facing.any(axis=1) & solid & large & (lit > 0.1))
    c = quads.corners[chosen].astype(np.float64)
    places = [*np.moveaxis(c, 1, 0), c.mean(axis=1)]
    visible = np.stack([light.sun_reaching(each) for each in places])
    tone = np.sqrt(np.minimum(quads.albedo[chosen].mean(axis=1), 0.6))
    crossed = chosen[(visible.max(axis=0) - visible.min(axis=0)) * lit[chosen] * tone > _SHADE_CONTRAST]
    counts = np.ones((len(quads), 2), np.int64)
    counts[crossed] = np.clip(np.round(lengths[crossed] / (_SHADE_PX * edge_px)), 1, _MAX_SHADE_CELLS)
    return quads.split(counts)
