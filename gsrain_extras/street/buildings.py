"""Buildings: roofs, dormers, chimneys, plain walls, and fronts with windows and doors."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.labels import Label
from gsrain_engine.scene.noise import layered_noise

from .layout import HOUSE_DEPTH_M, House, StreetLayout
from .mesh import Quads, box, broken_lines, even_lines, panel, patch, surface, tube

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_OVERHANG = 0.32
_LINING_DEPTH = 1.2


def build_houses(layout: StreetLayout) -> Quads:
    ends = [h for h in layout.ends if h.turn_deg < 0], [h for h in layout.ends if h.turn_deg > 0]
    built: list[Quads] = []
    for row in (layout.left, layout.right, *ends):
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
    """Two slopes with visible rows of tiles."""
    half = 0.5 * HOUSE_DEPTH_M
    slope = float(np.tan(np.radians(house.pitch_deg)))
    x = even_lines(0.0, house.width, 0.6 * house.detail)
    sides: list[Quads] = []
    for sign, spacing in ((1, 0.42), (-1, 1.4)):
        y = even_lines(-_OVERHANG, half, spacing * house.detail)
        across, z = y if sign > 0 else HOUSE_DEPTH_M - y, house.eaves + y * slope
        sides.append(surface(x[:, None], across, z, house.roof_color, Label.BUILDING, flipped=sign < 0))
    roof = Quads.joined(sides)
    center = roof.centers
    rng = np.random.default_rng(house.seed + 2)
    moss = layered_noise(center[:, :2] + house.seed % 887, 2.2, house.seed % 883)
    row = np.sin(center[:, 1] * 12.0)
    along = even_lines(0.0, house.width, 0.4 * house.detail)
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
        stack, cap = (x + 0.2, y, (foot + top) / 2), (x + 0.2, y, top + 0.05)
        found.append(box(stack, (0.8, 0.6, top - foot), brick, Label.BUILDING, coarse=0.45))
        found.append(box(cap, (0.95, 0.75, 0.12), (0.35, 0.33, 0.3), Label.BUILDING, coarse=0.35))
    return found


def _back(house: House) -> Quads:
    x, z = even_lines(0.0, house.width, 1.3), even_lines(0.0, house.eaves, 1.3)
    color = np.asarray(house.color) * 0.8
    return panel((house.width, HOUSE_DEPTH_M, 0), (-1.0, 0.0, 0.0), _Z, x, z, color, Label.BUILDING)


def _lining(house: House) -> Quads:
    """A wall inside the house in the front's color, which hides gaps between the front's Gaussians."""
    x, z = even_lines(0.0, house.width, 0.6), even_lines(0.0, house.eaves, 0.6)
    return panel((0, _LINING_DEPTH, 0), _X, _Z, x, z, house.color, Label.BUILDING, spread=0.7)


def _side(house: House, neighbour: House | None, *, at_start: bool) -> Quads:
    """Build the gable wall, from the neighbor's eaves upwards; the whole wall at the end of a row."""
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
    z = foot + rows * (top[:, None] - foot)
    wall = surface(x, y[:, None], z, np.asarray(house.color) * 0.85, Label.BUILDING, flipped=at_start)
    center = wall.centers
    stains = layered_noise(center[:, 1:] + house.seed % 877, (1.3, 2.5), house.seed % 881)
    return wall.tinted((0.82 + 0.36 * stains)[:, None])


def _dormers(house: House) -> Quads:
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
        front = np.array([[side * t, 0, 0], [side * t, 0, top]])
        rear = np.array([[side * t, deep, top - 0.02], [side * t, deep, top]])
        split = np.linspace(0, 1, 4)[:, None, None]
        grid = front * (1 - split) + rear * split
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
    return _inhabited(Quads.joined(one).repeated(offsets), len(offsets), house, 33)


# House fronts
# In the frame of the house: x along the front, y into the house, z up.


_FRAMES = ((0.66, 0.65, 0.62), (0.62, 0.62, 0.6), (0.10, 0.055, 0.03), (0.045, 0.075, 0.06), (0.6, 0.58, 0.52))


def house_front(house: House) -> Quads:
    """Build the front of a house, foot to eaves."""
    rng = np.random.default_rng(house.seed)
    bays = max(2, round(house.width / 2.75))
    bay = house.width / bays
    trim = np.asarray(house.color) * 0.3 + np.array([0.42, 0.40, 0.36]) * 0.75
    frame = _FRAMES[int(rng.integers(len(_FRAMES)))]
    wall = [*_upper_floors(house, bays, bay, trim, frame, rng), *_ground_floor(house, bays, bay, trim, frame, rng)]
    weathered = _weathered(Quads.joined(wall), house)
    return Quads.joined([weathered, *_cornices(house, trim), _drainpipe(house)])


def _upper_floors(house: House, bays: int, bay: float, trim: Any, frame: Any, rng: np.random.Generator) -> list[Quads]:
    width = float(rng.uniform(0.98, 1.22))
    height = float(rng.uniform(1.55, 1.85))
    columns = [((k + 0.5) * bay - 0.5 * width, (k + 0.5) * bay + 0.5 * width) for k in range(bays)]
    feet = [house.ground_height + k * house.floor_height + 0.95 for k in range(house.floors)]
    t = TRIM_M
    holes = [(x0 - t, x1 + t) for x0, x1 in columns]
    rows = [(z, z + height + t) for z in feet]
    parts = _wall(house, house.ground_height, house.eaves, holes, rows)
    make = window if house.detail < 1.4 else far_window
    kinds = [make(width, height, house.color, trim, frame, curtain, house.detail) for curtain in (0.0, 0.42, 0.65, 1.1)]
    corners = np.array([(x0, 0.0, z) for x0, _ in columns for z in feet])
    drawn = rng.choice(len(kinds), size=len(corners), p=[0.34, 0.3, 0.26, 0.1])
    for k, kind in enumerate(kinds):
        if np.any(drawn == k):
            parts.append(_inhabited(kind.repeated(corners[drawn == k]), int(np.sum(drawn == k)), house, 11 + k))
    if house.balconies and bays > 2 and house.detail < 2:
        for k in range(1, bays, 2):
            for z in feet[:-1]:
                parts.append(_balcony(0.5 * (columns[k][0] + columns[k][1]), z - 0.25, width + 0.9, trim))
    return parts


def _ground_floor(house: House, bays: int, bay: float, trim: Any, frame: Any, rng: np.random.Generator) -> list[Quads]:
    entrance = int(rng.integers(bays))
    door_hole = (entrance + 0.5) * bay - 0.6, (entrance + 0.5) * bay + 0.6, (0.0, 2.75)
    others = [k for k in range(bays) if k != entrance]
    stone = np.asarray(house.color) * 0.45 + np.array([0.24, 0.23, 0.21]) * 0.6
    parts: list[Quads] = []
    if house.shop and house.detail < 1.4:
        half, foot, top = 0.5 * bay - 0.28, 0.45, 2.85
        pane = shop_window(2 * half, top - foot, stone, house.accent, float(rng.uniform(0.2, 1.0)), house.detail)
        pane = pane.shining(_room_light(np.random.default_rng([house.seed, 21]), 1, _SHOP_LIT) * _SHOP_LIGHT)
        parts.append(pane.repeated(np.array([((k + 0.5) * bay - half, 0.0, foot) for k in others])))
        holes = [((k + 0.5) * bay - half, (k + 0.5) * bay + half, (foot, top)) for k in others]
        parts += _shop_front(house, others, bay, rng)
    else:
        half, foot, top = 0.55, 1.05, 2.75
        make = window if house.detail < 1.4 else far_window
        kind = make(2 * half, top - foot, stone, trim, frame, float(rng.choice([0.0, 0.6])), house.detail)
        row = kind.repeated(np.array([((k + 0.5) * bay - half, 0.0, foot) for k in others]))
        parts.append(_inhabited(row, len(others), house, 31))
        t = TRIM_M
        holes = [((k + 0.5) * bay - half - t, (k + 0.5) * bay + half + t, (foot, top + t)) for k in others]
    if house.detail < 1.4:
        entry = door(1.2, 2.75, stone, house.door_color, house.detail)
    else:
        entry = far_window(1.2, 2.75, stone, stone, house.door_color, 0.0, house.detail)
    parts.append(_inhabited(entry.placed((door_hole[0], 0, 0)), 1, house, 32))
    columns = sorted([*holes, door_hole])
    rows = [rows for *_, rows in columns]
    return [*parts, *_wall(house, 0.0, house.ground_height, [(x0, x1) for x0, x1, _ in columns], rows, stone)]


# Rooms by night

_LIT, _SHOP_LIT = 0.42, 0.85
"""Shares of lit rooms and of lit shops."""
_SHOP_LIGHT = 1.5
_BULBS = np.array([[1.0, 0.60, 0.27], [1.0, 0.68, 0.37], [1.0, 0.76, 0.50], [1.0, 0.88, 0.72], [0.42, 0.62, 1.0]])
"""Linear colors of light: bulbs of 2,500 to 4,000 K, and a screen."""


def _inhabited(windows: Quads, count: int, house: House, number: int) -> Quads:
    """Light a share of `count` copies of a window, one room each; the rest is dark. `number` is that of the draw."""
    rng = np.random.default_rng([house.seed, number])
    return windows.shining(np.repeat(_room_light(rng, count, _LIT), len(windows) // count, axis=0))


def _room_light(rng: np.random.Generator, count: int, lit: float) -> Float64[np.ndarray, "n 3"]:
    """Draw the light of rooms, linear; zero for a dark one."""
    color = _BULBS[rng.choice(len(_BULBS), size=count, p=[0.26, 0.32, 0.22, 0.14, 0.06])]
    strength = np.exp(rng.normal(-0.55, 0.5, count)) * (rng.random(count) < lit)
    return color * strength[:, None]


def _wall(
    house: House, z0: float, z1: float, holes: Sequence[tuple[float, float]], rows: Sequence[tuple[float, float]],
    stone: Any = None,
) -> list[Quads]:  # fmt: skip
    """Fill the wall around holes: full-height piers between the columns, spandrels inside them.

    Upper floors share all `rows` in every column; the ground floor (`stone`) has one row per column.
    """
    coarse = 0.5 * house.detail
    color = house.color if stone is None else stone
    tall = 0.6 * house.detail
    if stone is not None and not house.shop and house.detail < 1.4:  # courses of ashlar, with their joints
        joints = np.arange(z0 + 0.5, z1 - 0.2, 0.46)
        v_lines = np.sort(np.concatenate([[z0, z1], joints - 0.017, joints + 0.017]))
        v_lines = np.unique(np.concatenate([v_lines, 0.5 * (v_lines[1:] + v_lines[:-1])[np.diff(v_lines) > 0.1]]))
    else:
        v_lines = broken_lines([z0, z1], tall if house.wall == "plaster" else 0.62 * tall)
    edges = [0.0, *[x for hole in holes for x in hole], house.width]
    parts: list[Quads] = []
    for x0, x1 in zip(edges[::2], edges[1::2], strict=True):
        parts.append(panel((0, 0, 0), _X, _Z, broken_lines([x0, x1], coarse), v_lines, color, Label.BUILDING))
    for k, (x0, x1) in enumerate(holes):
        own = rows if stone is None else [rows[k]]
        levels = [z0, *[z for row in own for z in row], z1]
        for low, high in zip(levels[::2], levels[1::2], strict=True):
            if high - low > 1e-3:
                x, z = even_lines(x0, x1, coarse), broken_lines([low, high], coarse)
                parts.append(panel((0, 0, 0), _X, _Z, x, z, color, Label.BUILDING))
    return parts


def _weathered(front: Quads, house: House) -> Quads:
    """Texture the walls: bricks, stones or stained plaster, dirt at the foot, darkening under the eaves."""
    center = front.centers
    own = center[:, [0, 2]] + house.seed % 997
    z = center[:, 2]
    is_wall = (np.abs(center[:, 1]) < 0.01) & (front.gloss < 0.05)
    rng = np.random.default_rng(house.seed + 1)
    single = rng.uniform(-1, 1, len(front))
    stains = layered_noise(own, (1.6, 2.6), house.seed % 1009) - 0.5
    streaks = layered_noise(own, (0.25, 3.5), house.seed % 991 + 50) - 0.5
    strength = {"plaster": (0.015, 0.16, 0.12), "brick": (0.16, 0.14, 0.06), "stone": (0.09, 0.16, 0.08)}[house.wall]
    texture = 1 + strength[0] * single + strength[1] * stains + strength[2] * streaks
    joints = np.abs((z - 0.5 + 0.23) % 0.46 - 0.23) < 0.02
    if not house.shop:
        texture = np.where(joints & (z < house.ground_height - 0.2) & (z > 0.45), 0.62 * texture, texture)
    texture *= 1 - 0.28 * np.exp(-z / 0.35)
    factors = np.where(is_wall, texture, 1.0)
    corner = 1 - 0.4 * np.exp(-np.maximum(house.eaves - z, 0) / 0.35) - 0.3 * np.exp(-z / 0.5)
    tinted = front.tinted(factors[:, None])
    return replace(tinted, sky_access=tinted.sky_access * np.clip(corner, 0.2, 1).astype(np.float32))


def _cornices(house: House, trim: Any) -> list[Quads]:
    w = house.width
    coarse = 0.4 * house.detail
    lower = box((w / 2, -0.06, house.ground_height), (w, 0.16, 0.2), trim, Label.BUILDING, coarse=coarse,
                faces="yzZxX")  # fmt: skip
    upper = box((w / 2, -0.14, house.eaves - 0.13), (w, 0.34, 0.26), trim, Label.BUILDING, coarse=coarse,
                faces="yzZxX")  # fmt: skip
    frieze = strip(0.0, w, house.eaves - 0.5, house.eaves - 0.42, -0.05, np.asarray(trim) * 0.95, coarse)
    return [lower, upper, frieze]


def _drainpipe(house: House) -> Quads:
    z = even_lines(0.0, house.eaves - 0.3, 0.9 * house.detail)
    path = np.stack([np.full_like(z, 0.12), np.full_like(z, -0.08), z], axis=1)
    return tube(path, np.full(len(z), 0.05), (0.16, 0.165, 0.165), Label.BUILDING, sides=4, sky_access=0.8)


def _balcony(x: float, z: float, width: float, trim: Any) -> Quads:
    slab = box((x, -0.5, z - 0.07), (width, 1.0, 0.14), trim, Label.BUILDING, coarse=0.45, faces="xXyzZ")
    iron = (0.025, 0.027, 0.03)
    posts = np.linspace(x - 0.5 * width + 0.05, x + 0.5 * width - 0.05, max(8, round(width / 0.17)))
    bar = strip(float(posts[0]) - 0.012, float(posts[0]) + 0.012, z, z + 0.98, -0.96, iron, 0.35)
    front = bar.repeated(np.stack([posts - posts[0], np.zeros_like(posts), np.zeros_like(posts)], axis=1))
    rail = box((x, -0.96, z + 1.0), (width, 0.05, 0.045), iron, Label.BUILDING, coarse=0.4, faces="yYZ")
    sides: list[Quads] = []
    for end in (x - 0.5 * width + 0.03, x + 0.5 * width - 0.03):
        sides.append(box((end, -0.5, z + 1.0), (0.045, 0.95, 0.045), iron, Label.BUILDING, faces="xXZ"))
        across, up = np.array([0.0, 0.024]), broken_lines([0.0, 0.98], 0.35)
        for y in np.linspace(-0.85, -0.15, 5):
            sides.append(panel((end, y - 0.012, z), _Y, _Z, across, up, iron, Label.BUILDING))
    return Quads.joined([slab, front, rail, *sides])


def _shop_front(house: House, others: Sequence[int], bay: float, rng: np.random.Generator) -> list[Quads]:
    """Signboards over runs of neighboring display windows, and awnings over some."""
    runs: list[list[int]] = []
    for k in others:
        if runs and runs[-1][-1] == k - 1:
            runs[-1].append(k)
        else:
            runs.append([k])
    parts: list[Quads] = []
    for run in runs:
        x0, x1 = run[0] * bay + 0.2, (run[-1] + 1) * bay - 0.2
        middle, size = ((x0 + x1) / 2, -0.04, 3.2), (x1 - x0, 0.1, 0.5)
        parts.append(box(middle, size, house.accent, Label.BUILDING, coarse=0.5, faces="xXzZ"))
        parts.append(_word(x0, x1, house.accent, rng))
        if rng.random() < 0.6:
            parts.append(_awning(x0, x1, house.accent))
    return parts


def _word(x0: float, x1: float, color: Any, rng: np.random.Generator) -> Quads:
    """Front of a signboard with an illegible word: letters of two heights between 3.1 and 3.3 m."""
    letters = rng.uniform(0.12, 0.26, int(min(12, (x1 - x0) / 0.35)))
    ends = (x0 + x1) / 2 - letters.sum() * 0.65 + np.cumsum(1.3 * letters)
    tall = rng.random(len(letters)) < 0.3
    x = broken_lines([x0, *np.column_stack([ends - 1.3 * letters, ends - 0.3 * letters]).reshape(-1), x1], 0.5)
    z = np.array([2.95, 3.1, 3.23, 3.3, 3.45])
    middles = 0.5 * (x[:-1] + x[1:])
    letter = np.abs(middles[:, None] - (ends - 0.8 * letters)) < 0.5 * letters
    rows = np.stack([letter.any(axis=1), (letter & tall).any(axis=1)], axis=1)
    painted = np.pad(rows, ((0, 0), (1, 1))).reshape(-1, 1)
    return panel((0, -0.09, 0), _X, _Z, x, z, np.where(painted, (0.7, 0.66, 0.52), color), Label.BUILDING)


def _awning(x0: float, x1: float, color: Any) -> Quads:
    """Striped cloth that slopes from the wall to the street, with its valance."""
    x = even_lines(x0, x1, 0.26)
    y, z = np.array([-1.15, -0.8, -0.4, -0.06]), np.array([2.5, 2.64, 2.8, 2.93])
    points = np.stack(np.broadcast_arrays(x[:, None], y, z), axis=2)
    even = np.arange(len(x) - 1)[:, None] % 2 == 0
    stripes = np.where(even, [0.62, 0.59, 0.5], 2.2 * np.asarray(color))
    cloth = patch(points, np.repeat(stripes, 3, axis=0), Label.BUILDING)
    valance = panel((0, -1.15, 2.28), _X, _Z, x, np.array([0.0, 0.22]), stripes, Label.BUILDING)
    return Quads.joined([cloth, valance])


# Windows and doors
# In the frame of a house front: x along it, y into the house, z up.


REVEAL_M = 0.17
"""Depth of frames behind the wall."""

TRIM_M = 0.11
"""Width of the stone surround."""

_FRAME = 0.065
_GLOSS = 0.5


def strip(x0: float, x1: float, z0: float, z1: float, y: float, albedo: Any, step: float, **more: Any) -> Quads:
    """Make a narrow upright rectangle that faces the street: one or two cells across, long cells along."""
    wide = x1 - x0 > z1 - z0
    across = z1 - z0 if wide else x1 - x0
    cells = 1 if across < 0.12 else 2
    x = broken_lines([x0, x1], step) if wide else np.linspace(x0, x1, cells + 1)
    z = np.linspace(z0, z1, cells + 1) if wide else broken_lines([z0, z1], step)
    return panel((0, y, 0), _X, _Z, x, z, albedo, Label.BUILDING, **more)


def opening(width: float, height: float, wall: Any, step: float, deep: float = REVEAL_M) -> Quads:
    """Make the sides of a hole in the wall: left, right and upper reveal and the sill, 0 to `deep` behind the wall."""
    y = np.array([0.0, deep])
    x, z = even_lines(0.0, width, step), even_lines(0.0, height, step)
    left = panel((0, 0, 0), _Y, _Z, y, z, wall, Label.BUILDING, sky_access=0.55)
    right = panel((width, 0, 0), _Z, _Y, z, y, wall, Label.BUILDING, sky_access=0.55)
    upper = panel((0, 0, height), _Y, _X, y, x, wall, Label.BUILDING, sky_access=0.3)
    sill = panel((0, 0, 0), _X, _Y, x, y, wall, Label.BUILDING, sky_access=0.7)
    return Quads.joined([left, right, upper, sill])


def glass(x0: float, x1: float, z0: float, z1: float, y: float, curtain: float, coarse: float) -> Quads:
    """Make a pane: a dark room behind it, curtains at its sides (0: open, 1: drawn), the reflected street."""
    x, z = broken_lines([x0, x1], coarse), broken_lines([z0, z1], coarse)
    pane = panel((0, y, 0), _X, _Z, x, z, 0.02, Label.BUILDING, gloss=_GLOSS, sky_access=0.8)
    center = pane.centers
    sideways = np.abs(center[:, 0] - 0.5 * (x0 + x1)) / (0.5 * (x1 - x0))
    upwards = (center[:, 2] - z0) / (z1 - z0)
    room = 0.012 + 0.03 * upwards**2
    hung = sideways > 1.15 - curtain
    albedo = np.where(hung[:, None], [0.34, 0.33, 0.30], room[:, None] * np.array([1.0, 0.97, 0.9]))
    # By night a lit room is brightest at its ceiling, and curtains scatter its light.
    glow = np.where(hung[:, None], [0.80, 0.70, 0.58], (0.45 + 0.55 * upwards)[:, None])
    return Quads.of(
        pane.corners, albedo, Label.BUILDING, gloss=_GLOSS, sky_access=0.75, spread=pane.spread, emission=glow
    )


def window(width: float, height: float, wall: Any, trim: Any, frame: Any, curtain: float, detail: float) -> Quads:
    """Make a two-winged window with its surround; origin at the lower left corner of the hole, at the wall.

    The surround reaches `TRIM_M` beyond the hole on every side but the lower one, which has the sill.
    """
    step, coarse = 0.6 * detail, 0.34 * detail
    y, t = REVEAL_M, TRIM_M
    bar = 0.7 * height
    middle = 0.5 * width
    parts = [
        opening(width, height, wall, 0.5 * detail),
        strip(-t, 0.0, 0.0, height, 0.0, trim, step),
        strip(width, width + t, 0.0, height, 0.0, trim, step),
        strip(-t, width + t, height, height + t, 0.0, trim, step),
        strip(0.0, _FRAME, 0.0, height, y - 0.03, frame, step, sky_access=0.8),
        strip(width - _FRAME, width, 0.0, height, y - 0.03, frame, step, sky_access=0.8),
        strip(_FRAME, width - _FRAME, 0.0, _FRAME, y - 0.03, frame, step, sky_access=0.8),
        strip(_FRAME, width - _FRAME, height - _FRAME, height, y - 0.03, frame, step, sky_access=0.55),
        strip(middle - 0.045, middle + 0.045, _FRAME, height - _FRAME, y - 0.03, frame, step, sky_access=0.8),
    ]
    for x0, x1 in ((_FRAME, middle - 0.045), (middle + 0.045, width - _FRAME)):
        if height > 1.4:
            parts.append(strip(x0, x1, bar - 0.03, bar + 0.03, y - 0.03, frame, step, sky_access=0.8))
            parts.append(glass(x0, x1, bar + 0.03, height - _FRAME, y, min(curtain, 0.9), coarse))
            parts.append(glass(x0, x1, _FRAME, bar - 0.03, y, curtain, coarse))
        else:
            parts.append(glass(x0, x1, _FRAME, height - _FRAME, y, curtain, coarse))
    sill = box((middle, -0.04, -0.045), (width + 2 * t, 0.10, 0.09), trim, Label.BUILDING, coarse=0.5,
               faces="yZ")  # fmt: skip
    return Quads.joined([*parts, sill])


def far_window(width: float, height: float, wall: Any, trim: Any, frame: Any, curtain: float, detail: float) -> Quads:
    """Make a flat window for distant houses, of the same appearance; origin as for `window`."""
    del wall, detail
    t, bar, middle = TRIM_M, 0.7 * height, 0.5 * width
    x = np.array([0.0, _FRAME, 0.5 * (_FRAME + middle - 0.045), middle - 0.045, middle + 0.045,
                  0.5 * (width - _FRAME + middle + 0.045), width - _FRAME, width])  # fmt: skip
    z = np.array([0.0, _FRAME, 0.5 * bar, bar - 0.03, bar + 0.03, height - _FRAME, height])
    flat = panel((0, 0.02, 0), _X, _Z, x, z, 0.0, Label.BUILDING, sky_access=0.75)
    column, row = np.divmod(np.arange(len(flat)), len(z) - 1)
    wood = np.isin(column, (0, 3, 6)) | np.isin(row, (0, 3, 5))
    hung = np.isin(column, (1, 5)) & (curtain > 0.4) | (curtain > 1)
    albedo = np.where(wood[:, None], frame, np.where(hung[:, None], [0.3, 0.29, 0.26], 0.02))
    gloss = np.where(wood, 0.0, _GLOSS)
    parts = [
        Quads.of(
            flat.corners,
            albedo,
            Label.BUILDING,
            gloss=gloss,
            sky_access=0.75,
            spread=flat.spread,
            emission=np.where(wood, 0.0, np.where(hung, 0.70, 0.55 + 0.25 * (row > 2)))[:, None],
        ),
        strip(-t, 0.0, 0.0, height, 0.0, trim, 1.0),
        strip(width, width + t, 0.0, height, 0.0, trim, 1.0),
        strip(-t, width + t, height, height + t, 0.0, trim, 0.7),
        strip(-t, width + t, -0.08, 0.0, -0.06, trim, 0.7),
    ]
    return Quads.joined(parts)


def shop_window(width: float, height: float, wall: Any, frame: Any, warm: float, detail: float) -> Quads:
    """Make a display window with goods behind it; origin as for `window`, `warm` lights the room (0 to 1)."""
    y = REVEAL_M
    f = 0.08
    bar = height - 0.55
    parts = [
        opening(width, height, wall, 0.5 * detail),
        strip(0.0, f, 0.0, height, y - 0.03, frame, 0.45),
        strip(width - f, width, 0.0, height, y - 0.03, frame, 0.45),
        strip(f, width - f, 0.0, f, y - 0.03, frame, 0.45),
        strip(f, width - f, height - f, height, y - 0.03, frame, 0.45),
        strip(f, width - f, bar - 0.03, bar + 0.03, y - 0.03, frame, 0.45),
    ]
    for z0, z1 in ((f, bar - 0.03), (bar + 0.03, height - f)):
        pane = glass(f, width - f, z0, z1, y, 0.0, 0.26 * detail)
        center = pane.centers
        cells = np.floor(center[:, [0, 2]] / [0.42, 0.5]).astype(int)
        pick = np.sin(cells[:, 0] * 12.99 + cells[:, 1] * 78.23) * 0.5 + 0.5
        goods = np.where((center[:, 2] < 0.5 * height) & (pick > 0.45), 1.0, 0.0)
        color = np.stack([0.10 + 0.22 * pick, 0.10 + 0.12 * np.roll(pick, 3), 0.08 + 0.12 * (1 - pick)], axis=1)
        lamp = warm * np.exp(-(((center[:, 2] - 0.75 * height) / 0.5) ** 2))
        room = 0.03 + 0.14 * lamp[:, None] * np.array([1.0, 0.8, 0.5])
        albedo = room + 0.55 * goods[:, None] * color
        glow = 0.5 + 0.5 * np.clip(center[:, 2] / height, 0, 1)[:, None]
        shown = np.where(goods[:, None] > 0, 3.0 * color, 1.0)  # goods under lamps, before a lit wall
        parts.append(
            Quads.of(
                pane.corners,
                albedo,
                Label.BUILDING,
                gloss=0.5,
                sky_access=0.8,
                spread=pane.spread,
                emission=glow * shown,
            )
        )
    return Quads.joined(parts)


def door(width: float, height: float, wall: Any, color: Any, detail: float) -> Quads:
    """Make a paneled door with a light above it; origin at the lower left corner of the hole, at the wall."""
    deep = 0.28
    top = min(height - 0.12, 2.15)
    wood = np.asarray(color, np.float64)
    x = broken_lines([0.0, 0.1, 0.5 * width - 0.06, 0.5 * width + 0.06, width - 0.1, width], 0.3)
    z = broken_lines([0.0, 0.16, 0.95, 1.1, top - 0.14, top], 0.5 * detail)
    leaf = panel((0, deep, 0), _X, _Z, x, z, wood, Label.BUILDING, gloss=0.12, sky_access=0.6)
    center = leaf.centers
    inset = (np.abs(center[:, 0] - 0.5 * width) > 0.06) & (np.abs(center[:, 0] - 0.5 * width) < 0.5 * width - 0.1)
    inset &= ((center[:, 2] > 0.16) & (center[:, 2] < 0.95)) | ((center[:, 2] > 1.1) & (center[:, 2] < top - 0.14))
    leaf = leaf.tinted(np.where(inset, 0.6, 1.15)[:, None])
    brass = (0.5, 0.42, 0.25)
    knob = (0.5 * width + 0.1, deep - 0.04, 1.02)
    handle = box(knob, (0.05, 0.06, 0.18), brass, Label.BUILDING, gloss=0.3)
    transom = strip(0.0, width, top, top + 0.08, deep, wood * 1.2, 0.3, sky_access=0.5)
    light = glass(0.0, width, top + 0.08, height, deep, 0.0, 0.3)
    return Quads.joined([opening(width, height, wall, 0.5 * detail, deep), leaf, handle, transom, light])
