"""Refinement of quads for sharp pictures: small cells at color edges, outlines and shadows, where the ego passes close.

The front camera of the ego on its way decides: a cell at an edge has about the size of a pixel where it is closest, and
its neighbors grow away from the edge. Surfaces of one color need few large cells.

A leaf has one to 13 overlapping Gaussians, which together have the alpha of its quad.

Of two neighbors the one whose center is nearer covers the other: for a camera that looks along the street, the one with
the smaller x. So a cell's visible end is where its own Gaussian is half transparent, on its far side, and the next one
begins beneath it. Gaussians placed for that leave small gaps, which a wide one in the middle of the surface fills, and
colors stay where they belong.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64, UInt64

from gsrain_engine.scene.labels import Label

from .layout import StreetParameters
from .lighting import Illumination
from .mesh import NEAREST_FIRST, Quads, geometric_normals

GROWTH = 2.0
"""Ratio of a cell's width to that of its neighbor nearer to the edge."""

_MAX_CELLS = 9  # one digit, as `_groups` takes them
_UNSEEN = 4.0  # factor on the cells of surfaces that the front camera does not see: other cameras do
_FILLED = 4  # minimum number of cells of a surface whose gaps another Gaussian fills, in its middle
_FILLING_SPREAD = 0.25  # in widths of the surface
_FILLING_SIZE = 0.125  # of its quad, which is one of the mesh, too
_FILLING_DEPTH_M = 0.002  # behind the cells: seen from ahead, all centers of a surface have one depth
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
    lengths, facing, passed = _view(quads, line)
    leaf, seen = _is_leaf(quads), facing.any(axis=1)
    sides, beyond = _edges(quads, facing)
    sides = np.where(((quads.opacity > 0.9) & ~leaf)[:, None], sides, _NO_EDGE)
    ends, beyond = (np.stack([each[:, [3, 1]], each[:, [0, 2]]], axis=1) for each in (sides, beyond))  # along u and v
    steps = edge_px * np.where(seen & passed, 1.0, _UNSEEN)
    counts = np.stack([_cell_count(lengths[:, k] / steps, ends[:, k]) for k in (0, 1)], axis=1)
    cells = counts[:, 0] * counts[:, 1]
    filled = seen & (cells >= _FILLED)
    more = np.where(leaf, _leaf_parts(lengths.prod(axis=1) / edge_px**2), filled)
    first = np.cumsum(cells + more) - cells - more
    parent = np.repeat(np.arange(len(quads)), cells + more)
    place = np.arange(len(parent)) - first[parent]
    cut = quads.take(parent)
    for (i, j, *at), own in _groups(np.concatenate([counts, ends.reshape(-1, 4)], axis=1)):
        rows = (first[own, None] + np.arange(i * j)).reshape(-1)
        cut.corners[rows] = _cells(quads.corners[own], _graded(i, at[0], at[1]), _graded(j, at[2], at[3]))
    cell = np.minimum(place, cells[parent] - 1)
    rows_of = cell // counts[parent, 1], cell % counts[parent, 1]  # along u and v
    for k, (spread, shift) in enumerate(_footprints(quads, counts, ends, beyond, facing)):
        cut.spread[:, k], cut.shift[:, k] = spread[parent, rows_of[k]], shift[parent, rows_of[k]]
    _fill_gaps(cut, np.flatnonzero(filled[parent] & (place == cells[parent])))
    for shapes in _LEAF_SHAPES:
        rows = np.flatnonzero(leaf[parent] & (more[parent] == len(shapes) - 1))
        cut.shift[rows], cut.spread[rows] = np.split(np.array(shapes, np.float32)[place[rows]], 2, axis=1)
    return cut


def _groups(digits: Int64[np.ndarray, "n k"]) -> Iterator[tuple[list[int], Int64[np.ndarray, " m"]]]:
    """Yield the different rows of digits from 0 to 9, in order, and the places of each, ascending."""
    if not len(digits):
        return
    tens = 10 ** np.arange(digits.shape[1] - 1, -1, -1)
    codes = digits @ tens
    counts = np.bincount(codes)
    found = np.flatnonzero(counts)
    numbers = np.zeros(len(counts), np.uint16)  # small ones are sorted by their digits, in a fraction of the time
    numbers[found] = np.arange(len(found))
    order = np.argsort(numbers[codes], kind="stable")
    for code, places in zip(found, np.split(order, np.cumsum(counts[found])[:-1]), strict=True):
        yield (code // tens % 10).tolist(), places


def _fill_gaps(quads: Quads, rows: Int64[np.ndarray, " m"]) -> None:
    """Make quads wide Gaussians behind their middle, of small quads, which are part of the mesh as well."""
    corners = quads.corners[rows]
    middle = corners.mean(axis=1, keepdims=True)
    behind = (_FILLING_DEPTH_M * geometric_normals(corners.astype(np.float64)))[:, None]
    quads.corners[rows] = middle + np.float32(_FILLING_SIZE) * (corners - middle) - behind.astype(np.float32)
    quads.spread[rows], quads.shift[rows] = _FILLING_SPREAD / _FILLING_SIZE, 0


def _is_leaf(quads: Quads) -> Bool[np.ndarray, " n"]:
    return (quads.labels == Label.VEGETATION) & (quads.opacity < 0.99)


def _axes(quads: Quads) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Twice the mean sides of quads along u and v, in meters."""
    c = quads.corners.astype(np.float64)
    return c[:, 1] + c[:, 2] - c[:, 0] - c[:, 3], c[:, 2] + c[:, 3] - c[:, 0] - c[:, 1]


# Leaves
# Gaussians of one leaf: offsets along u and v from its middle, and standard deviations, in widths of the quad; found as
# the least error of their alpha, one over the other, from a square, for pixels of 1/8, 1/10 and 1/14 of it.


_Shape = tuple[float, float, float, float]


def _around(offset: float, across: float, along: float, aside: float = 0.0) -> list[_Shape]:
    """Gaussians along the four sides, `offset` from the middle; two at each side if they are set aside."""
    one = {(i * offset, j * aside, across, along) for i in (-1, 1) for j in (-1, 1)}
    return sorted(one | {(y, x, t, s) for x, y, s, t in one})


_LEAF_SHAPES = (
    [(0.0, 0.0, 0.267, 0.267), *_around(0.345, 0.109, 0.321)],
    [(0.0, 0.0, 0.230, 0.230), *_around(0.404, 0.063, 0.320), *_around(0.216, 0.164, 0.164, 0.216)],
    [(0.0, 0.0, 0.217, 0.217), *_around(0.262, 0.116, 0.245), *_around(0.412, 0.057, 0.203, 0.193)],
)
_LEAF_AREAS = 3.0, 20.0, 60.0
"""Minimum area of a leaf of each shape, in cells at edges."""


def _leaf_parts(areas: Float64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """Numbers of Gaussians of leaves beyond the first, from their areas in cells at edges."""
    numbers = np.array([0, *(len(shapes) - 1 for shapes in _LEAF_SHAPES)])
    return numbers[np.searchsorted(_LEAF_AREAS, areas)]


def _cell_count(length: Float64[np.ndarray, " n"], ends: Int64[np.ndarray, "n 2"]) -> Int64[np.ndarray, " n"]:
    """Number of cells along sides of a length in cells at the edge: 1 + G + G^2 + ... from each end at an edge."""
    both = (ends > _NO_EDGE).all(axis=1)
    steps = np.log1p(np.where(both, 0.5, 1.0) * length * (GROWTH - 1)) / np.log(GROWTH)
    count = np.clip(np.round(np.where(both, 2, 1) * steps), 1, _MAX_CELLS).astype(np.int64)
    return np.where((ends > _NO_EDGE).any(axis=1), count, 1)


def _graded(count: int, first: int, last: int) -> Float64[np.ndarray, " m"]:
    """Lines from 0 to 1 around cells that grow from the ends at edges."""
    k = np.arange(count)
    if first and last:
        k = np.minimum(k, k[::-1])
    elif last:
        k = k[::-1]
    widths = GROWTH**k
    return np.concatenate([[0.0], np.cumsum(widths) / widths.sum()])


def _cells(
    corners: Float[np.ndarray, "n 4 3"], u: Float64[np.ndarray, " i"], v: Float64[np.ndarray, " j"]
) -> Float64[np.ndarray, "m 4 3"]:
    """Cells of quads between lines along u and v, bilinear; those of one quad follow each other, v fastest."""
    c = corners.astype(np.float64)[:, None, None]
    a, b = u[None, :, None, None], v[None, None, :, None]
    points = (1 - b) * ((1 - a) * c[..., 0, :] + a * c[..., 1, :]) + b * ((1 - a) * c[..., 3, :] + a * c[..., 2, :])
    around = points[:, :-1, :-1], points[:, 1:, :-1], points[:, 1:, 1:], points[:, :-1, 1:]
    return np.stack(around, axis=3).reshape(-1, 4, 3)


def _view(
    quads: Quads, line: CameraLine
) -> tuple[Float64[np.ndarray, "n 2"], Bool[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Lengths of u and v in px where the camera passes closest; whether it sees the front from three distances.

    The third array tells whether the quad is in the image at any time. A quad leaves the image at the depth where the
    line of sight to it has the slope of the field of view.
    """
    c = quads.corners.astype(np.float64)
    middle = c.mean(axis=1)
    aside, above = middle[:, 1] - line.y, middle[:, 2] - line.z
    closest = np.maximum(np.maximum(np.abs(aside) / _SLOPES[0], np.abs(above) / _SLOPES[1]), _NEAREST_M)
    depth = np.maximum(closest, middle[:, 0] - line.last_x)
    farthest = middle[:, 0] - line.first_x
    normals = geometric_normals(c)
    lengths = np.empty((len(quads), 2))
    for k, edge in enumerate(_axes(quads)):
        across, up = edge[:, 1] - aside / depth * edge[:, 0], edge[:, 2] - above / depth * edge[:, 0]
        lengths[:, k] = 0.5 * _FOCAL_PX / depth * np.hypot(across, up)
    facing = np.empty((len(quads), len(_FARTHER)), np.bool_)
    for k, times in enumerate(_FARTHER):
        ahead = np.minimum(times * depth, np.maximum(farthest, depth))
        facing[:, k] = ahead * normals[:, 0] + aside * normals[:, 1] + above * normals[:, 2] < 0
    return lengths, facing, farthest >= closest


# Footprints
# In cell widths; found for the far ends in `NEAREST_FIRST`, by the error of pictures from the front camera.

_HALF = np.sqrt(2 * np.log(2))  # deviations from a Gaussian's center to where it is half transparent
_LEVEL_SPREAD = 0.64  # standard deviation inside level ground, where nothing is behind gaps
_SPREAD = 0.55  # and inside other surfaces, which end and bend
_LAST_SPREAD, _LAST_REACH = 0.5, 1.5  # of a cell at an edge on its far side, and deviations from center to that edge
_FIRST_SPREAD = 0.30  # of a cell at an outline on its near side, in its middle
_HIDDEN_SPREAD = 0.2  # of a cell at an outline that the camera does not see, so that it does not stand out behind it
_CLEAR, _CLEAR_COLOR = 2.1, 1.9  # minimum deviations from other centers to an outline, and to a color edge before them
_HIDDEN_CLEAR = 3.0  # from centers of hidden surfaces to outlines, also to those of the next quad
_ROUND = 0.5  # spreads below this, without edges at both ends, are those of thin poles

_Columns = tuple[Float32[np.ndarray, "n i"], Float32[np.ndarray, "n i"]]


def _footprints(
    quads: Quads,
    counts: Int64[np.ndarray, "n 2"],
    ends: Int64[np.ndarray, "n 2 2"],
    beyond: Float64[np.ndarray, "n 2 2"],
    facing: Bool[np.ndarray, "n 3"],
) -> Iterator[_Columns]:
    """Standard deviations and offsets of the Gaussians of cells, in cell widths, along u, then v; columns are cells."""
    hidden, level = ~facing.any(axis=1), np.abs(quads.normals[:, 2]) > 0.9
    fixed = _is_leaf(quads) | (quads.opacity <= 0.9)
    for k, axis in enumerate(_axes(quads)):
        room = beyond[:, k] / np.maximum(0.5 * np.linalg.norm(axis, axis=1), 1e-9)[:, None]
        spread = np.repeat(quads.spread[:, k : k + 1], counts[:, k].max(), axis=1)
        shift = np.zeros_like(spread)
        thin = (quads.spread[:, k] < _ROUND) & (ends[:, k] == _NO_EDGE).all(axis=1)
        chosen = np.flatnonzero(~(fixed | thin))
        key = np.column_stack([counts[:, k], ends[:, k], axis @ NEAREST_FIRST > 0, hidden, level])[chosen]
        for (count, first, last, ascending, is_hidden, is_level), own in _groups(key):
            lines, inside = _graded(count, first, last), _LEVEL_SPREAD if is_level else _SPREAD
            rows = chosen[own]
            if ascending:
                widths, offset = _placed(lines, first, last, inside, bool(is_hidden), room[rows])
            else:
                widths, offset = _placed(1 - lines[::-1], last, first, inside, bool(is_hidden), room[rows, ::-1])
                widths, offset = widths[:, ::-1], -offset[:, ::-1]
            spread[rows, :count], shift[rows, :count] = widths, offset
        yield spread, shift


def _placed(
    lines: Float64[np.ndarray, " m"],
    near: int,
    far: int,
    inside: float,
    hidden: bool,
    room: Float64[np.ndarray, "n 2"],
) -> tuple[Float64[np.ndarray, "n i"], Float64[np.ndarray, "n i"]]:
    """Standard deviations and offsets, in cell widths, of cells between lines from the near end (0) to the far one.

    `room` is the distance from the near and the far end to outlines of the next quads there.
    """
    widths, last = np.diff(lines), len(lines) - 2
    spread, shift = np.empty((len(room), len(widths))), np.empty((len(room), len(widths)))
    clear = _HIDDEN_CLEAR if hidden else _CLEAR
    for k, (start, stop, width) in enumerate(zip(lines, lines[1:], widths, strict=False)):
        at_far, at_near = far and k == last, near and k == 0
        reach, own = (_LAST_REACH, _LAST_SPREAD * width) if at_far else (_HALF, inside * width)
        if far and not at_far:
            own = np.minimum(own, (1 - stop) / (clear - reach))
        if near and not at_near:
            own = np.minimum(own, stop / (reach + (_CLEAR_COLOR if near == _COLOR_EDGE else clear)))
        if hidden:
            own = np.minimum(own, (1 - stop + room[:, 1]) / (clear - reach))
            own = np.minimum(own, (stop + room[:, 0]) / (reach + clear))
        middle = stop - reach * own
        if at_near and near == _OUTLINE:
            own, middle = _FIRST_SPREAD * width, 0.5 * (start + stop)
        if hidden and ((at_near and near == _OUTLINE) or (at_far and far == _OUTLINE)):
            own, middle = _HIDDEN_SPREAD * width, 0.5 * (start + stop)
        spread[:, k], shift[:, k] = own / width, (middle - 0.5 * (start + stop)) / width
    return spread, shift


# Edges

_NO_EDGE, _COLOR_EDGE, _OUTLINE = 0, 1, 2


def _edges(
    quads: Quads, facing: Bool[np.ndarray, "n 3"]
) -> tuple[Int64[np.ndarray, "n 4"], Float64[np.ndarray, "n 4"]]:
    """Kinds of sides (corners 0-1, 1-2, 2-3, 3-0): there the color changes, or the surface ends or turns away.

    The second array has the size of the next quad at each side if that ends at an outline opposite, else infinity.
    """
    points = _hashed(np.round(quads.corners.astype(np.float64) / _SAME_M).astype(np.int64))
    following = np.roll(points, -1, axis=1)
    sides = (np.minimum(points, following) * np.uint64(3) + np.maximum(points, following)).reshape(-1)
    order = np.argsort(sides, kind="stable")
    same = np.flatnonzero(sides[order[1:]] == sides[order[:-1]])
    a, b = order[same], order[same + 1]
    tones, one, other = _tones(quads), a // 4, b // 4
    differs = np.max(np.abs(tones[one] - tones[other]), axis=1) > _CONTRAST
    kind = np.where((facing[one] != facing[other]).any(axis=1), _OUTLINE, np.where(differs, _COLOR_EDGE, _NO_EDGE))
    kinds = np.full(len(sides), _OUTLINE)
    kinds[a] = kinds[b] = _NO_EDGE
    np.maximum.at(kinds, a, kind)
    np.maximum.at(kinds, b, kind)
    kinds = np.where(points != following, kinds.reshape(-1, 4), _NO_EDGE)
    u, v = (0.5 * np.linalg.norm(axis, axis=1) for axis in _axes(quads))
    widths = np.where(np.roll(kinds, 2, axis=1) == _OUTLINE, np.stack([v, u, v, u], axis=1), np.inf).reshape(-1)
    room = np.full(len(sides), np.inf)
    np.minimum.at(room, a, widths[b])
    np.minimum.at(room, b, widths[a])
    return kinds, room.reshape(-1, 4)


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
    lengths, facing, passed = _view(quads, line)
    lit = np.maximum(quads.normals @ light.sun.astype(np.float32), 0) * quads.sun_access
    large = lengths.max(axis=1, initial=0) > 1.5 * _SHADE_PX * edge_px
    solid = (quads.labels != Label.VEGETATION) & (quads.opacity > 0.9)
    chosen = np.flatnonzero(facing.any(axis=1) & passed & solid & large & (lit > 0.1))
    c = quads.corners[chosen].astype(np.float64)
    places = [*np.moveaxis(c, 1, 0), c.mean(axis=1)]
    visible = np.stack([light.sun_reaching(each) for each in places])
    tone = np.sqrt(np.minimum(quads.albedo[chosen].mean(axis=1), 0.6))
    crossed = chosen[(visible.max(axis=0) - visible.min(axis=0)) * lit[chosen] * tone > _SHADE_CONTRAST]
    counts = np.ones((len(quads), 2), np.int64)
    counts[crossed] = np.clip(np.round(lengths[crossed] / (_SHADE_PX * edge_px)), 1, _MAX_SHADE_CELLS)
    return quads.split(counts)
