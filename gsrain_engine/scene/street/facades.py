"""House fronts in the frame of the house: x along the front, y into the house, z up."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .grids import box, even_lines, graded_lines, panel, patch, tube
from .labels import Label
from .layout import House
from .noise import layered_noise
from .quads import Quads
from .windows import TRIM_M, door, far_window, shop_window, strip, window

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_FRAMES = ((0.66, 0.65, 0.62), (0.62, 0.62, 0.6), (0.10, 0.055, 0.03), (0.045, 0.075, 0.06), (0.6, 0.58, 0.52))
_EDGE = 0.04


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
    parts += [kind.repeated(corners[drawn == k]) for k, kind in enumerate(kinds) if np.any(drawn == k)]
    if house.balconies and bays > 2 and house.detail < 2:
        for k in range(1, bays, 2):
            for z in feet[:-1]:
                parts.append(_balcony(0.5 * (columns[k][0] + columns[k][1]), z - 0.25, width + 0.9, trim))
    return parts


def _ground_floor(house: House, bays: int, bay: float, trim: Any, frame: Any, rng: np.random.Generator) -> list[Quads]:
    entrance = int(rng.integers(bays))
    doors = [((entrance + 0.5) * bay - 0.6, (entrance + 0.5) * bay + 0.6)]
    door_rows = [(0.0, 2.75)]
    others = [k for k in range(bays) if k != entrance]
    stone = np.asarray(house.color) * 0.45 + np.array([0.24, 0.23, 0.21]) * 0.6
    parts: list[Quads] = []
    if house.shop and house.detail < 1.4:
        half, foot, top = 0.5 * bay - 0.28, 0.45, 2.85
        pane = shop_window(2 * half, top - foot, stone, house.accent, float(rng.uniform(0.2, 1.0)), house.detail)
        parts.append(pane.repeated(np.array([((k + 0.5) * bay - half, 0.0, foot) for k in others])))
        holes = [((k + 0.5) * bay - half, (k + 0.5) * bay + half, (foot, top)) for k in others]
        parts += _shop_front(house, others, bay, rng)
    else:
        half, foot, top = 0.55, 1.05, 2.75
        make = window if house.detail < 1.4 else far_window
        kind = make(2 * half, top - foot, stone, trim, frame, float(rng.choice([0.0, 0.6])), house.detail)
        parts.append(kind.repeated(np.array([((k + 0.5) * bay - half, 0.0, foot) for k in others])))
        t = TRIM_M
        holes = [((k + 0.5) * bay - half - t, (k + 0.5) * bay + half + t, (foot, top + t)) for k in others]
    if house.detail < 1.4:
        entry = door(1.2, 2.75, stone, house.door_color, house.detail)
    else:
        entry = far_window(1.2, 2.75, stone, stone, house.door_color, 0.0, house.detail)
    parts.append(entry.placed((doors[0][0], 0, 0)))
    columns = sorted([*holes, (*doors[0], door_rows[0])])
    parts += _wall(
        house, 0.0, house.ground_height, [(x0, x1) for x0, x1, _ in columns], [rows for *_, rows in columns],
        stone=stone,
    )  # fmt: skip
    return parts


def _wall(
    house: House,
    z0: float,
    z1: float,
    holes: Sequence[tuple[float, float]],
    rows: Sequence[tuple[float, float]],
    stone: Any = None,
) -> list[Quads]:
    """Fill the wall around holes: full-height piers between the columns, spandrels inside them.

    Upper floors share all `rows` in every column; the ground floor (`stone`) has one row a column.
    """
    edge, coarse = _EDGE * house.detail, 0.5 * house.detail
    color = house.color if stone is None else stone
    tall = 0.6 * house.detail
    if (
        stone is not None and not house.shop and house.detail < 1.4
    ):  # courses of ashlar: the joints are lines of their own
        joints = np.arange(z0 + 0.5, z1 - 0.2, 0.46)
        v_lines = np.sort(np.concatenate([[z0, z1], joints - 0.017, joints + 0.017]))
        edge *= 2
        v_lines = np.unique(np.concatenate([v_lines, 0.5 * (v_lines[1:] + v_lines[:-1])[np.diff(v_lines) > 0.1]]))
    else:
        v_lines = graded_lines([z0, z1], 2 * edge, tall if house.wall == "plaster" else 0.62 * tall)
    edges = [0.0, *[x for hole in holes for x in hole], house.width]
    parts: list[Quads] = []
    for x0, x1 in zip(edges[::2], edges[1::2], strict=True):
        parts.append(_plain(x0, x1, graded_lines([x0, x1], edge, coarse), v_lines, color))
    for k, (x0, x1) in enumerate(holes):
        own = rows if stone is None else [rows[k]]
        levels = [z0, *[z for row in own for z in row], z1]
        for low, high in zip(levels[::2], levels[1::2], strict=True):
            if high - low > 1e-3:
                lines = graded_lines([low, high], edge, coarse)
                parts.append(_plain(x0, x1, even_lines(x0, x1, coarse), lines, color))
    return parts


def _plain(x0: float, x1: float, x: Any, z: Any, color: Any) -> Quads:
    return panel((0, 0, 0), _X, _Z, x, z, color, Label.BUILDING)


def _weathered(front: Quads, house: House) -> Quads:
    """Give walls their texture: bricks, stones or stained plaster, dirt at the foot, dusk under the eaves."""
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
    coarse = 0.7 * house.detail
    lower = box((w / 2, -0.06, house.ground_height), (w, 0.16, 0.2), trim, Label.BUILDING, edge=0.1, coarse=coarse,
                faces="yzZxX")  # fmt: skip
    upper = box((w / 2, -0.14, house.eaves - 0.13), (w, 0.34, 0.26), trim, Label.BUILDING, edge=0.12, coarse=coarse,
                faces="yzZxX")  # fmt: skip
    frieze = strip(0.0, w, house.eaves - 0.5, house.eaves - 0.42, -0.05, np.asarray(trim) * 0.95, coarse)
    return [lower, upper, frieze]


def _drainpipe(house: House) -> Quads:
    z = even_lines(0.0, house.eaves - 0.3, 0.9 * house.detail)
    path = np.stack([np.full_like(z, 0.12), np.full_like(z, -0.08), z], axis=1)
    return tube(path, np.full(len(z), 0.05), (0.16, 0.165, 0.165), Label.BUILDING, sides=4, sky_access=0.8)


def _balcony(x: float, z: float, width: float, trim: Any) -> Quads:
    slab = box((x, -0.5, z - 0.07), (width, 1.0, 0.14), trim, Label.BUILDING, edge=0.1, coarse=0.45, faces="xXyzZ")
    iron = (0.025, 0.027, 0.03)
    posts = np.linspace(x - 0.5 * width + 0.05, x + 0.5 * width - 0.05, max(8, round(width / 0.17)))
    bars = [strip(float(p) - 0.012, float(p) + 0.012, z, z + 0.98, -0.96, iron, 0.35) for p in posts[:1]]
    front = bars[0].repeated(np.stack([posts - posts[0], np.zeros_like(posts), np.zeros_like(posts)], axis=1))
    rail = box((x, -0.96, z + 1.0), (width, 0.05, 0.045), iron, Label.BUILDING, edge=0.2, coarse=0.4, faces="yYZ")
    sides: list[Quads] = []
    for end in (x - 0.5 * width + 0.03, x + 0.5 * width - 0.03):
        sides.append(box((end, -0.5, z + 1.0), (0.045, 0.95, 0.045), iron, Label.BUILDING, edge=0.2, faces="xXZ"))
        for y in np.linspace(-0.85, -0.15, 5):
            sides.append(
                panel((end, y - 0.012, z), _Y, _Z, np.array([0.0, 0.024]), graded_lines([0.0, 0.98], 0.1, 0.35), iron,
                      Label.BUILDING)
            )  # fmt: skip
    return Quads.joined([slab, front, rail, *sides])


def _shop_front(house: House, others: Sequence[int], bay: float, rng: np.random.Generator) -> list[Quads]:
    """Sign boards over runs of neighbouring display windows, and awnings over some."""
    runs: list[list[int]] = []
    for k in others:
        if runs and runs[-1][-1] == k - 1:
            runs[-1].append(k)
        else:
            runs.append([k])
    parts: list[Quads] = []
    for run in runs:
        x0, x1 = run[0] * bay + 0.2, (run[-1] + 1) * bay - 0.2
        parts.append(
            box(((x0 + x1) / 2, -0.04, 3.2), (x1 - x0, 0.1, 0.5), house.accent, Label.BUILDING, edge=0.07, coarse=0.5,
                faces="xXyzZ")
        )  # fmt: skip
        letters = rng.uniform(0.12, 0.26, int(min(12, (x1 - x0) / 0.35)))
        at = (x0 + x1) / 2 - letters.sum() * 0.65
        for width in letters:  # a word that nobody can read
            tall = 0.13 if rng.random() < 0.7 else 0.2
            parts.append(strip(float(at), float(at + width), 3.1, 3.1 + tall, -0.11, (0.7, 0.66, 0.52), 0.2))
            at += width * 1.3
        if rng.random() < 0.6:
            parts.append(_awning(x0, x1, house.accent))
    return parts


def _awning(x0: float, x1: float, color: Any) -> Quads:
    """Striped cloth that slopes from the wall to the street, with its valance."""
    x = even_lines(x0, x1, 0.26)
    y, z = np.array([-1.15, -0.8, -0.4, -0.06]), np.array([2.5, 2.64, 2.8, 2.93])
    points = np.stack(np.broadcast_arrays(x[:, None], y, z), axis=2)
    even = np.arange(len(x) - 1)[:, None] % 2 == 0
    stripes = np.where(even, [0.62, 0.59, 0.5], 2.2 * np.asarray(color))
    cloth = patch(points, np.repeat(stripes, 3, axis=0), Label.BUILDING)
    under = patch(points[:, ::-1], np.repeat(0.5 * stripes, 3, axis=0), Label.BUILDING, sky_access=0.4)
    valance = panel((0, -1.15, 2.28), _X, _Z, x, np.array([0.0, 0.22]), stripes, Label.BUILDING)
    return Quads.joined([cloth, under.placed((0, 0, -0.01)), valance])
