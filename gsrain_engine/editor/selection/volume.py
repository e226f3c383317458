"""Selection in 3D: within a sphere or a box, grow and shrink, and flood fill of connected, similar Gaussians."""

from dataclasses import dataclass, replace
from typing import no_type_check

import numpy as np
import scipy
from jaxtyping import Bool, Float64, Int64

from ...kernels import kernel
from ...scene.flags import BitMask
from ...scene.scene import DrawItem, Scene
from ..edits.gaussians import CropBox
from .candidates import Found, base_color, candidates, select_similar_colors, selected, visible_gaussians


@dataclass(frozen=True)
class Sphere:
    """A sphere in the world."""

    center_m: tuple[float, float, float]
    radius_m: float

    def reaching(self, eye_m: Float64[np.ndarray, "3"], sight: Float64[np.ndarray, "3"]) -> "Sphere":
        """Return the sphere around the same center that a line of sight touches; `sight` is a unit vector."""
        to_center = self.middle - eye_m
        across = to_center - (to_center @ sight) * sight
        return replace(self, radius_m=max(float(np.linalg.norm(across)), 0.01))

    @property
    def middle(self) -> Float64[np.ndarray, "3"]:
        return np.array(self.center_m)

    def circles_m(self, points: int) -> Float64[np.ndarray, "3 points 3"]:
        """Points on the three great circles in the planes of the world's axes."""
        angle = np.linspace(0, 2 * np.pi, points, endpoint=False)
        flat = np.stack([np.cos(angle), np.sin(angle), np.zeros(points)], axis=1)
        return self.middle + self.radius_m * np.stack([np.roll(flat, axis, axis=1) for axis in range(3)])

    @property
    def to_unit(self) -> Float64[np.ndarray, "4 4"]:
        """Matrix that maps the sphere to the unit sphere."""
        matrix = np.eye(4)
        matrix[:3, :3] /= self.radius_m
        matrix[:3, 3] = -self.middle / self.radius_m
        return matrix


Volume = Sphere | CropBox


def placed_on(box: CropBox, point_m: Float64[np.ndarray, "3"]) -> CropBox:
    """Return the box with the center of its bottom moved to a point."""
    x, y, z = point_m.tolist()
    return replace(box, center_m=(x, y, z + box.size_m[2] / 2))


def in_volume(scene: Scene, time_s: float, volume: Volume) -> dict[str, BitMask]:
    """Find the Gaussians with centers in a volume at a time, also those outside the image."""
    to_unit = volume.to_unit if isinstance(volume, Sphere) else np.linalg.inv(volume.to_world)
    found: dict[str, BitMask] = {}
    for key, part in candidates(scene, time_s).items():
        flags = np.empty(len(part.gaussians), np.bool_)
        own_to_unit = np.ascontiguousarray((to_unit @ part.to_world)[:3])
        _find_inside(part.gaussians.means, own_to_unit, isinstance(volume, Sphere), flags)
        found[key] = BitMask.of(flags)
    return found


@kernel(error_model="numpy")
@no_type_check
def _find_inside(means, m, is_round, flags):
    """Flag Gaussian centers that a matrix maps into the unit sphere, or into the cube from -1 to 1."""
    for i in range(len(means)):
        x, y, z = means[i, 0], means[i, 1], means[i, 2]
        a = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
        b = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
        c = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        if is_round:
            flags[i] = a * a + b * b + c * c <= 1
        else:
            flags[i] = abs(a) <= 1 and abs(b) <= 1 and abs(c) <= 1


# Grow and shrink


def near_selection(scene: Scene, time_s: float, distance_m: float, inside: bool = False) -> dict[str, BitMask]:
    """Find shown Gaussians within a distance of selected ones, or with `inside` selected ones near any others."""
    own = candidates(scene, time_s)
    members = [scene.member(key) for key in own]
    chosen = {each.key: selected(each) & visible_gaussians(each) for each in members}
    others = {each.key: visible_gaussians(each) - selected(each) for each in members}
    points, rows = _world_points(own, chosen if inside else others)
    sources, _ = _world_points(own, others if inside else chosen)
    return _masks(own, rows[_reached(points, sources, distance_m)])


def _world_points(
    parts: dict[str, DrawItem], among: Found
) -> tuple[Float64[np.ndarray, "m 3"], Int64[np.ndarray, " m"]]:
    """Centers in the world (meters) of Gaussians, and their rows, increasing, counted through all parts."""
    points, rows, first = [np.zeros((0, 3))], [np.zeros(0, np.int64)], 0
    for key, part in parts.items():
        mask = among.get(key)
        if mask:
            indices = mask.indices
            points.append(part.gaussians.means[indices] @ part.to_world[:3, :3].T + part.to_world[:3, 3])
            rows.append(first + indices)
        first += len(part.gaussians)
    return np.concatenate(points), np.concatenate(rows)


def _masks(parts: dict[str, DrawItem], rows: Int64[np.ndarray, " m"]) -> dict[str, BitMask]:
    """Masks of the Gaussians in rows that are counted through all parts."""
    ends = np.cumsum([len(part.gaussians) for part in parts.values()], dtype=np.int64)
    flags = np.zeros(ends[-1] if len(ends) else 0, np.bool_)
    flags[rows] = True
    return {key: BitMask.of(own) for key, own in zip(parts, np.split(flags, ends), strict=False)}


def _reached(
    points: Float64[np.ndarray, "m 3"], sources: Float64[np.ndarray, "k 3"], distance_m: float
) -> Bool[np.ndarray, " m"]:
    flags = np.zeros(len(points), np.bool_)
    if not len(sources) or not len(points):
        return flags
    low, high = sources.min(axis=0) - distance_m, sources.max(axis=0) + distance_m
    rows = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    if not len(rows):
        return flags
    low, high = points[rows].min(axis=0) - distance_m, points[rows].max(axis=0) + distance_m
    near = sources[((sources >= low) & (sources <= high)).all(axis=1)]
    if len(near):
        # Distances beyond the bound are infinite.
        tree = scipy.spatial.KDTree(near, balanced_tree=False, compact_nodes=False)
        found, _ = tree.query(points[rows], distance_upper_bound=np.nextafter(distance_m, np.inf), workers=-1)
        flags[rows] = found <= distance_m
    return flags


# Flood fill

_NEIGHBORS = 8  # number of neighbors that defines the spacing
_EDGE = 1 << 20  # maximum number of cells from the seed: three numbers of 21 bits form a key


def flood_select(
    scene: Scene, time_s: float, key: str, index: int, tolerance: float, reach: float
) -> dict[str, BitMask]:
    """Find the Gaussians that a flood fill from a seed Gaussian reaches.

    It covers Gaussians whose base color differs from the seed's by at most `tolerance` (0..1, each channel), and
    spreads from each cell of a grid to the 26 around it. Cells are `reach` times as wide as the spacing of similar
    Gaussians at the seed: the distance to the eighth nearest.
    """
    own = candidates(scene, time_s)
    similar = select_similar_colors(scene, time_s, base_color(own[key], index), tolerance)
    points, rows = _world_points(own, similar)
    before = list(own.values())[: list(own).index(key)]
    at = int(np.searchsorted(rows, sum(len(part.gaussians) for part in before) + index))
    squares, nearest = ((points - points[at]) ** 2).sum(axis=1), min(_NEIGHBORS, len(points) - 1)
    side = reach * max(float(np.sqrt(np.partition(squares, nearest)[nearest])), 1e-6)
    cells = np.floor((points - points[at]) / side + 0.5)
    flags = np.zeros(len(points), np.bool_)
    near = np.flatnonzero(np.abs(cells).max(axis=1) < _EDGE)
    flags[near] = connected_cells(cells[near].astype(np.int64), int(np.searchsorted(near, at)))
    return _masks(own, rows[flags])


@kernel()
@no_type_check
def connected_cells(cells: Int64[np.ndarray, "m 3"], seed: int) -> Bool[np.ndarray, " m"]:
    """Flag the points whose cells connect to the seed's through neighbors, by a hash table at most half full."""
    size = 16
    while size < 2 * len(cells):
        size *= 2
    keys, slots = np.full(size, -1, np.int64), np.empty(len(cells), np.int64)
    for i in range(len(cells)):
        key = _key(cells[i, 0], cells[i, 1], cells[i, 2])
        slot = _slot(keys, key)
        keys[slot] = key
        slots[i] = slot
    reached, waiting, count = np.zeros(size, np.bool_), np.empty(size, np.int64), 1
    reached[slots[seed]] = True
    waiting[0] = slots[seed]
    while count:
        count -= 1
        key = keys[waiting[count]]
        x, y, z = (key >> 42) - _EDGE, ((key >> 21) & 0x1FFFFF) - _EDGE, (key & 0x1FFFFF) - _EDGE
        for step in range(27):
            slot = _slot(keys, _key(x + step // 9 - 1, y + step // 3 % 3 - 1, z + step % 3 - 1))
            if keys[slot] >= 0 and not reached[slot]:
                reached[slot] = True
                waiting[count] = slot
                count += 1
    return reached[slots]


@kernel()
@no_type_check
def _key(x, y, z):
    return ((x + _EDGE) << 42) | ((y + _EDGE) << 21) | (z + _EDGE)


@kernel()
@no_type_check
def _slot(keys, key):
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    slot = np.int64((mixed ^ (mixed >> np.uint64(32))) & np.uint64(len(keys) - 1))
    while keys[slot] >= 0 and keys[slot] != key:
        slot = (slot + 1) & (len(keys) - 1)
    return slot
