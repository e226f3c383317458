"""Whole houses: front, roof, dormers, chimneys, and the plain walls beside and behind."""

from collections.abc import Sequence

import numpy as np

from .facades import house_front
from .grids import box, even_lines, panel, patch, tube
from .labels import Label
from .layout import HOUSE_DEPTH_M, House, StreetLayout
from .noise import layered_noise
from .quads import Quads
from .windows import window

_X, _Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
_OVERHANG = 0.32
_LINING_DEPTH = 1.2


def build_houses(layout: StreetLayout) -> Quads:
    """Build all rows of houses, in the world."""
    rows: list[Sequence[House]] = [layout.left, layout.right]
    ends = layout.ends
    rows += [[h for h in ends if h.turn_deg < 0], [h for h in ends if h.turn_deg > 0]]
    built: list[Quads] = []
    for row in rows:
        for k, house in enumerate(row):
            before = row[k - 1] if k > 0 else None
            after = row[k + 1] if k + 1 < len(row) else None
            # Rows are listed along the world's axis; right and far rows run backwards in their own frame.
            first, last = (before, after) if house.turn_deg in (0.0, 90.0) else (after, before)
            built.append(_house(house, first, last).placed(house.origin, house.turn_deg))
    return Quads.joined(built)


def _house(house: House, first: House | None, last: House | None) -> Quads:
    parts = [house_front(house), _lining(house), _roof(house), *_chimneys(house), _back(house)]
    parts += [_side(house, first, at_start=True), _side(house, last, at_start=False)]
    if house.dormers:
        parts.append(_dormers(house))
    return Quads.joined(parts)


def _roof(house: House) -> Quads:
    """Two slopes of tiles whose rows can be told apart."""
    half = 0.5 * HOUSE_DEPTH_M
    slope = float(np.tan(np.radians(house.pitch_deg)))
    x = even_lines(0.0, house.width, 0.6 * house.detail)
    sides: list[Quads] = []
    for sign, spacing in ((1, 0.42), (-1, 1.4)):
        y = even_lines(-_OVERHANG, half, spacing * house.detail)
        across = y if sign > 0 else HOUSE_DEPTH_M - y
        points = np.stack(np.broadcast_arrays(x[:, None], across, house.eaves + y * slope), axis=2)
        sides.append(patch(points if sign > 0 else points[::-1], house.roof_color, Label.BUILDING))
    roof = Quads.joined(sides)
    center = roof.centers
    rng = np.random.default_rng(house.seed + 2)
    moss = layered_noise(center[:, :2] + house.seed % 887, 2.2, house.seed % 883)
    row = np.sin(center[:, 1] * 12.0)
    along = even_lines(0.0, house.width, 0.8)
    gutter_path = np.stack(np.broadcast_arrays(along, -_OVERHANG - 0.05, house.eaves - 0.08), axis=1)
    gutter = tube(gutter_path, np.full(len(along), 0.07), (0.15, 0.155, 0.16), Label.BUILDING, sides=5)
    tinted = roof.tinted((0.72 + 0.42 * moss + 0.1 * rng.uniform(-1, 1, len(roof)) + 0.05 * row)[:, None])
    return Quads.joined([tinted, gutter])


def _chimneys(house: House) -> list[Quads]:
    rng = np.random.default_rng(house.seed + 3)
    brick = (0.27, 0.13, 0.09)
    places = [0.3 + 0.05 * rng.random()] + ([house.width - 0.5] if rng.random() < 0.4 else [])
    found: list[Quads] = []
    for x in places:
        y, top = 0.5 * HOUSE_DEPTH_M - 0.8, house.ridge + 0.9
        foot = house.ridge - 1.6
        found.append(box((x + 0.2, y, (foot + top) / 2), (0.8, 0.6, top - foot), brick, Label.BUILDING, edge=0.2,
                         coarse=0.45))  # fmt: skip
        found.append(box((x + 0.2, y, top + 0.05), (0.95, 0.75, 0.12), (0.35, 0.33, 0.3), Label.BUILDING, edge=0.2,
                         coarse=0.35))  # fmt: skip
    return found


def _back(house: House) -> Quads:
    x, z = even_lines(0.0, house.width, 1.3), even_lines(0.0, house.eaves, 1.3)
    color = np.asarray(house.color) * 0.8
    return panel((house.width, HOUSE_DEPTH_M, 0), (-1.0, 0.0, 0.0), _Z, x, z, color, Label.BUILDING)


def _lining(house: House) -> Quads:
    """A wall of the front's colour inside the house: what shines through between its Gaussians looks like itself."""
    x, z = even_lines(0.0, house.width, 1.2), even_lines(0.0, house.eaves, 1.2)
    return panel((0, _LINING_DEPTH, 0), _X, _Z, x, z, house.color, Label.BUILDING, spread=0.7)


def _side(house: House, neighbour: House | None, *, at_start: bool) -> Quads:
    """Build the gable wall, from the neighbour's eaves upwards; the whole wall at the end of a row."""
    foot = 0.0 if neighbour is None else max(0.0, min(neighbour.eaves, house.eaves) - 0.3)
    if neighbour is not None and neighbour.ridge > house.ridge + 0.5 and neighbour.eaves > house.eaves + 0.5:
        return Quads.joined([])
    spacing = 0.6 if neighbour is None else 0.7
    part = even_lines(0.0, 1.0, spacing / HOUSE_DEPTH_M)
    rows = even_lines(0.0, 1.0, spacing / (house.ridge - foot))
    y = part * HOUSE_DEPTH_M
    slope = np.tan(np.radians(house.pitch_deg))
    top = house.eaves + slope * (0.5 * HOUSE_DEPTH_M - np.abs(y - 0.5 * HOUSE_DEPTH_M)) - 0.04
    x = 0.0 if at_start else house.width
    points = np.stack(
        [
            np.full((len(y), len(rows)), x),
            np.broadcast_to(y[:, None], (len(y), len(rows))),
            foot + rows * (top[:, None] - foot),
        ],
        axis=2,
    )
    wall = patch(points[::-1] if at_start else points, np.asarray(house.color) * 0.85, Label.BUILDING)
    center = wall.centers
    stains = layered_noise(center[:, 1:] + house.seed % 877, (1.3, 2.5), house.seed % 881)
    return wall.tinted((0.82 + 0.36 * stains)[:, None])


def _dormers(house: House) -> Quads:
    """Small gabled windows in the front slope."""
    bays = max(2, round(house.width / 2.75))
    bay = house.width / bays
    slope = float(np.tan(np.radians(house.pitch_deg)))
    w, h, y = 1.0, 1.15, 0.9
    z = house.eaves + y * slope - 0.1
    trim = np.array([0.5, 0.48, 0.44])
    slate = np.asarray(house.roof_color) * 0.9
    one = [window(w, h, trim, trim, (0.6, 0.6, 0.58), 0.5, house.detail).placed((-w / 2, 0, 0.12))]
    t, deep = w / 2 + 0.11, (h + 0.5) / slope
    top = h + 0.27
    for side in (-1, 1):
        cheek = np.array(
            [[[side * t, 0, 0], [side * t, 0, top]], [[side * t, deep, top - 0.02], [side * t, deep, top]]]
        )
        split = np.linspace(0, 1, 4)[:, None, None]
        grid = cheek[0] * (1 - split) + cheek[1] * split
        one.append(patch(grid if side > 0 else grid[::-1], slate, Label.BUILDING, sky_access=0.8))
        ridge = np.array([0.0, 0.0, top + 0.5])
        eave = np.array([side * (t + 0.12), 0.0, top - 0.08])
        back = np.array([0.0, deep + 0.6, 0.0])
        along = np.linspace(0, 1, 5)[:, None, None]
        rise = np.linspace(0, 1, 4)[None, :, None]
        slope_points = (eave - [0, 0.15, 0]) * (1 - rise) + (ridge - [0, 0.15, 0]) * rise + along * back
        one.append(patch(slope_points[::-1] if side > 0 else slope_points, slate, Label.BUILDING))
    split = np.linspace(0, 1, 5)[:, None, None]
    foot = np.array([-t, -0.01, top - 0.02]) + split * [2 * t, 0, 0]
    peak = np.broadcast_to([0, -0.01, top + 0.45], foot.shape)
    one.append(patch(np.concatenate([foot, peak], axis=1), trim * 0.9, Label.BUILDING))
    offsets = np.array([((k + 0.5) * bay, y, z) for k in range(0, bays, 2)])
    return Quads.joined(one).repeated(offsets)
