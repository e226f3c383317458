"""Ground: carriageway and markings, cross streets, sidewalks, and the surroundings with hills."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float64

from gsrain_engine.scene.labels import Label
from gsrain_engine.scene.noise import lattice_noise, layered_noise, smooth_noise

from .layout import (
    CROSS_LENGTH_M,
    CROSS_ROAD_M,
    CROSS_SIDEWALK_M,
    CROSSING_LENGTH_M,
    CURB_HEIGHT_M,
    HOUSE_DEPTH_M,
    StreetLayout,
)
from .mesh import Quads, broken_lines, even_lines, panel, surface

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_ASPHALT = np.array([0.088, 0.088, 0.090])
_PAINT = np.array([0.50, 0.50, 0.48])
_DASH_M, _PERIOD_M = 3.0, 7.5
_STEP_M = 0.3  # cell size along the street; dashes begin and end on multiples of it
_STOP_LINE_M = 0.42
_SEAM_M = 0.035


def build_road(layout: StreetLayout) -> Quads:
    """Build the road between the curbs and the crossing streets, at z = 0."""
    p = layout.parameters
    stops = [p.start_x_m, *[x for c in layout.crossings for x in (c, c + CROSSING_LENGTH_M)], p.end_x_m]
    parts = [_lanes(layout, x0, x1) for x0, x1 in zip(stops[::2], stops[1::2], strict=True)]
    parts += [_crossing(layout, c) for c in layout.crossings]
    for side in (-1, 1):
        parts += [_parking(layout, x0, x1, side) for x0, x1 in zip(stops[::2], stops[1::2], strict=True)]
    road = _worn(Quads.joined(parts), layout)
    return Quads.joined([road, *(_cross_street(layout, end) for end in (-1, 1))])


def _lanes(layout: StreetLayout, x0: float, x1: float) -> Quads:
    w = layout.parameters.lane_width_m
    seams = [-0.62 * w, -0.62 * w + _SEAM_M, 0.38 * w, 0.38 * w + _SEAM_M]
    y = broken_lines([-w, -w + 0.1, *seams[:2], -0.06, 0.06, *seams[2:], w - 0.1, w], 0.25)
    first = np.ceil(x0 / _STEP_M - 1e-6) * _STEP_M
    inner = np.arange(first, x1 + 1e-6, _STEP_M)
    lines = np.unique(np.round(np.concatenate([[x0, x1], inner[(inner > x0 + 0.1) & (inner < x1 - 0.1)]]), 6))
    ends = [c - 1.0 for c in layout.crossings if abs(c - x1) < 1e-6]
    for end in ends:  # separate rows for the stop line before a crossing
        lines = lines[(lines < end - _STOP_LINE_M - 0.12) | (lines > end + 0.12)]
        lines = np.sort(np.concatenate([lines, np.linspace(end - _STOP_LINE_M, end, 4)]))
    across = _cross_seams(layout, x0, x1)
    for seam in across:
        lines = lines[(lines < seam - 0.1) | (lines > seam + 0.1)]
        lines = np.sort(np.concatenate([lines, [seam - 0.5 * _SEAM_M, seam + 0.5 * _SEAM_M]]))
    road = panel((0, 0, 0), _X, _Y, lines, y, _ASPHALT, Label.ROAD)
    center = road.centers
    tar = np.zeros(len(road), bool)
    for seam in seams[::2]:
        tar |= (center[:, 1] > seam) & (center[:, 1] < seam + _SEAM_M)
    for seam in across:
        tar |= np.abs(center[:, 0] - seam) < 0.5 * _SEAM_M
    road = road.tinted(np.where(tar, 0.42, 1.0)[:, None])
    dash = (np.abs(center[:, 1]) < 0.06) & (center[:, 0] % _PERIOD_M < _DASH_M)
    border = np.abs(np.abs(center[:, 1]) - (w - 0.05)) < 0.05
    stop_line = np.zeros(len(road), bool)
    for end in ends:
        stop_line |= (center[:, 0] > end - _STOP_LINE_M) & (center[:, 0] < end) & (center[:, 1] < -0.06)
    return _painted(road, dash | border | stop_line)


def _cross_seams(layout: StreetLayout, x0: float, x1: float) -> list[float]:
    """Transverse joints of the asphalt, tarred, across both lanes."""
    rng = np.random.default_rng([layout.parameters.seed, 13, round(10 * x0) + 10_000])
    places = np.cumsum(rng.uniform(7.0, 19.0, 40)) + x0
    return [float(x) + 0.11 for x in np.floor(places / _STEP_M) * _STEP_M if x < x1 - 6.0]


def _crossing(layout: StreetLayout, x: float) -> Quads:
    """Build a zebra crossing, curb to curb: stripes of half a meter along the driving direction."""
    edge = layout.parameters.curb_y_m
    count = int(np.floor(edge / 0.5))
    stops = [float(y) for y in np.arange(-count, count + 1) * 0.5]
    breaks = [-edge, *stops, edge] if edge - stops[-1] > 1e-6 else stops
    y = broken_lines(breaks, 0.16)
    lines = broken_lines([x, x + CROSSING_LENGTH_M], _STEP_M)
    road = panel((0, 0, 0), _X, _Y, lines, y, _ASPHALT, Label.ROAD)
    stripe = np.floor(road.centers[:, 1] / 0.5).astype(int) % 2 == 0
    return _painted(road, stripe & (np.abs(road.centers[:, 1]) < stops[-1]))


def _parking(layout: StreetLayout, x0: float, x1: float, side: int) -> Quads:
    """Build a parking lane with its gutter; short white marks separate the bays."""
    p = layout.parameters
    inner, outer = p.lane_width_m, p.curb_y_m
    y = np.append(broken_lines([inner, outer - 0.3, outer], 0.3), outer + 0.1)  # a little under the curb
    marks = [float(m) for m in np.arange(p.start_x_m + 3.0, p.end_x_m, 6.1) if x0 + 1 < m < x1 - 1]
    lines = broken_lines([x0, *[e for m in marks for e in (m - 0.06, m + 0.06)], x1], 0.34)
    road = panel((0, 0, 0), _X, _Y, lines, y if side > 0 else -y[::-1], 0.92 * _ASPHALT, Label.ROAD)
    center = road.centers
    at_mark = np.min(np.abs(center[:, :1] - np.array([marks or [1e9]])), axis=1) < 0.06
    gutter = np.abs(center[:, 1]) > outer - 0.3
    slots = _painted(road, at_mark & ~gutter)
    return slots.tinted(np.where(gutter, 1.45, 1.0)[:, None])


def _painted(road: Quads, paint: Bool[np.ndarray, " n"]) -> Quads:
    return replace(
        road,
        albedo=np.where(paint[:, None], _PAINT, road.albedo).astype(np.float32),
        labels=np.where(paint, np.uint8(Label.LANE_MARKING), road.labels),
    )


def _worn(road: Quads, layout: StreetLayout) -> Quads:
    """Add grain, wheel tracks, repairs and oil stains to the asphalt, and wear to the markings."""
    p = layout.parameters
    center = road.centers[:, :2].astype(np.float64)
    rng = np.random.default_rng([p.seed, 11])
    painted = road.labels == Label.LANE_MARKING
    grain = 0.075 * rng.uniform(-1, 1, len(road))
    clouds = 0.34 * (layered_noise(center, (3.4, 1.3), p.seed + 21, 4) - 0.5)
    lengthwise = 0.22 * (smooth_noise(center, (14.0, 0.35), p.seed + 31) - 0.5)
    own_lane = np.abs(np.abs(center[:, 1]) - 0.5 * p.lane_width_m)
    tracks = 0.13 * np.exp(-(((own_lane - 0.75) / 0.28) ** 2)) - 0.10 * np.exp(-((own_lane / 0.3) ** 2))
    asphalt = 1 + grain + clouds + lengthwise + tracks - 0.18 * _repairs(center, layout)
    worn = 0.93 + 0.05 * grain / 0.075 - 0.5 * np.clip(layered_noise(center, 0.9, p.seed + 41, 3) - 0.62, 0, 1)
    return road.tinted(np.where(painted, worn, asphalt)[:, None])


def _repairs(center: Float64[np.ndarray, "n 2"], layout: StreetLayout) -> Float64[np.ndarray, " n"]:
    """Mask of trenches filled with darker asphalt: 1 inside, 0 outside."""
    p = layout.parameters
    rng = np.random.default_rng([p.seed, 12])
    inside = np.zeros(len(center))
    for _ in range(14 * max(1, int(p.length_m / 180.0))):
        x = np.round(rng.uniform(p.start_x_m, p.end_x_m) / _STEP_M) * _STEP_M
        y = rng.uniform(-p.lane_width_m, p.lane_width_m - 1.0)
        length, width = _STEP_M * rng.integers(5, 26), rng.uniform(0.7, 1.6)
        inside[(center[:, 0] > x) & (center[:, 0] < x + length) & (center[:, 1] > y) & (center[:, 1] < y + width)] = 1
    return inside


def _cross_street(layout: StreetLayout, end: int) -> Quads:
    """Build the street that crosses at the end (1) or behind the start (-1), curb to curb."""
    p = layout.parameters
    near = p.end_x_m if end > 0 else p.start_x_m
    x0 = near + end * CROSS_SIDEWALK_M
    x1 = x0 + end * CROSS_ROAD_M
    mouth_x = even_lines(min(near, x0), max(near, x0), _STEP_M)
    mouth_y = even_lines(-p.curb_y_m, p.curb_y_m, 0.35)
    x, y = even_lines(min(x0, x1), max(x0, x1), 0.5), even_lines(-CROSS_LENGTH_M, CROSS_LENGTH_M, 0.8)
    road = Quads.joined(
        [panel((0, 0, 0), _X, _Y, *lines, _ASPHALT, Label.ROAD) for lines in ((mouth_x, mouth_y), (x, y))]
    )
    center = road.centers[:, :2].astype(np.float64)
    clouds = layered_noise(center, 1.8, p.seed + 51, 4)
    return road.tinted((0.83 + 0.34 * clouds)[:, None])


# Sidewalks


_SLAB = np.array([0.235, 0.225, 0.205])
_GRANITE = np.array([0.30, 0.295, 0.285])
_SOIL = np.array([0.075, 0.05, 0.032])
CURB_WIDTH_M = 0.15


def build_sidewalks(layout: StreetLayout) -> Quads:
    """Build both sidewalks of the street and those of the crossing streets."""
    return Quads.joined([part(layout, side) for part in (_side, _across) for side in (1, -1)])


def _side(layout: StreetLayout, side: int) -> Quads:
    p = layout.parameters
    kerb, front = p.curb_y_m, p.front_y_m
    x = even_lines(p.start_x_m, p.end_x_m, 0.5)
    x_soft = even_lines(p.start_x_m, p.end_x_m, 0.6)
    y_slabs = np.append(np.arange(kerb + CURB_WIDTH_M, front - 0.2, 0.5), [front, front + 0.2])
    slabs = _level(x, y_slabs, side, _SLAB, Label.PAVEMENT, CURB_HEIGHT_M)
    center = slabs.centers.astype(np.float64)
    cell = np.floor(np.stack([center[:, 0], np.abs(center[:, 1]) - kerb], axis=1) / 0.5)
    own = lattice_noise(cell.astype(np.int64), p.seed + 61 + side)
    dirt = layered_noise(center[:, :2], (2.2, 1.1), p.seed + 62, 3)
    slabs = slabs.tinted((0.80 + 0.17 * own + 0.28 * (dirt - 0.35))[:, None])
    for tree in layout.trees:
        if tree.y * side > 0:
            pit = (np.abs(center[:, 0] - tree.x) < 0.51) & (np.abs(center[:, 1] - tree.y) < 0.51)
            soil = np.where(pit[:, None], _SOIL * (0.7 + 0.6 * own[:, None]), slabs.albedo).astype(np.float32)
            slabs = replace(slabs, albedo=soil)
    top = _level(x_soft, np.linspace(kerb, kerb + CURB_WIDTH_M, 3), side, _GRANITE, Label.PAVEMENT, CURB_HEIGHT_M)
    face = _curb_face(x_soft, kerb, side)
    stones = Quads.joined([top, face])
    stone = np.floor(stones.centers[:, :1].astype(np.float64) / 1.2).astype(np.int64)
    shade = 0.88 + 0.24 * lattice_noise(stone, p.seed + 63 + side)
    lowered = np.zeros(len(stones), bool)
    for c in layout.crossings:  # curbs are painted light at crossings
        lowered |= (stones.centers[:, 0] > c) & (stones.centers[:, 0] < c + CROSSING_LENGTH_M)
    return Quads.joined([slabs, stones.tinted((shade * np.where(lowered, 1.25, 1.0))[:, None])])


def _level(x: np.ndarray, y: np.ndarray, side: int, albedo: np.ndarray, label: Label, z: float) -> Quads:
    lines = y if side > 0 else -y[::-1]
    return panel((0, 0, z), _X, _Y, x, lines, albedo, label)


def _curb_face(x: np.ndarray, kerb: float, side: int) -> Quads:
    z = np.array([-0.06, 0.0, 0.5 * CURB_HEIGHT_M, CURB_HEIGHT_M])
    axes = (_X, _Z, x, z) if side > 0 else (_Z, _X, z, x)
    return panel((0, side * kerb, 0), *axes, 0.9 * _GRANITE, Label.PAVEMENT, sky_access=0.75)


def _across(layout: StreetLayout, end: int) -> Quads:
    """Build the sidewalks along a crossing street: a whole one on the far side, two halves on the near side."""
    p = layout.parameters
    near = p.end_x_m if end > 0 else p.start_x_m
    parts: list[Quads] = []
    far = near + end * (CROSS_SIDEWALK_M + CROSS_ROAD_M)
    strips = [(far, far + end * CROSS_SIDEWALK_M, -CROSS_LENGTH_M, CROSS_LENGTH_M)]
    strips += [(near, near + end * CROSS_SIDEWALK_M, s * p.curb_y_m, s * CROSS_LENGTH_M) for s in (1, -1)]
    for xa, xb, ya, yb in strips:
        x, y = even_lines(min(xa, xb), max(xa, xb), 0.65), even_lines(min(ya, yb), max(ya, yb), 0.65)
        flat = panel((0, 0, CURB_HEIGHT_M), _X, _Y, x, y, _SLAB, Label.PAVEMENT)
        center = flat.centers[:, :2].astype(np.float64)
        parts.append(flat.tinted((0.8 + 0.3 * layered_noise(center, 1.5, p.seed + 64, 3))[:, None]))
        z = np.array([0.0, 0.5 * CURB_HEIGHT_M, CURB_HEIGHT_M])
        kerb_x = far if xa == far else near + end * CROSS_SIDEWALK_M
        facing_minus_x = (end > 0) == (xa == far)
        axes = (_Z, _Y, z, y) if facing_minus_x else (_Y, _Z, y, z)
        parts.append(panel((kerb_x, 0, 0), *axes, _GRANITE, Label.PAVEMENT))
    for s in (1, -1):  # corners at the mouth of the street
        low, high = sorted((near, near + end * CROSS_SIDEWALK_M))
        parts.append(_curb_face(broken_lines([low, high], 0.6), p.curb_y_m, s))
        parts.append(_yard(layout, end, s))
    return Quads.joined(parts)


def _yard(layout: StreetLayout, end: int, side: int) -> Quads:
    """Build the paved ground next to the last house of a row, along the crossing street."""
    p = layout.parameters
    near = p.end_x_m if end > 0 else p.start_x_m
    x0, x1 = sorted((near, near - end * 0.6))
    y0, y1 = sorted((side * (p.front_y_m + HOUSE_DEPTH_M), side * CROSS_LENGTH_M))
    x, y = even_lines(x0, x1, 0.6), even_lines(y0, y1, 1.2)
    return panel((0, 0, CURB_HEIGHT_M), _X, _Y, x, y, _SLAB, Label.PAVEMENT)


# Surroundings

_GROUND_RADIUS_M = 420.0
_HILLS_AT_M = (260.0, 380.0)
_ROUND_LENGTH_M = 260.0  # maximum length of a street with round surroundings


def longer_by_m(layout: StreetLayout) -> float:
    """Distance by which the surroundings of a long street reach farther along it than those of a short one."""
    return 0.5 * max(0.0, layout.parameters.length_m - _ROUND_LENGTH_M)


def build_surroundings(layout: StreetLayout) -> Quads:
    """Build the ground around the street and two ranges of hills, in the world."""
    p = layout.parameters
    hills = (_hills(radius, k, p.seed, longer_by_m(layout)) for k, radius in enumerate(_HILLS_AT_M))
    return Quads.joined([_ground(layout), *hills]).placed((0.5 * (p.start_x_m + p.end_x_m), 0.0, 0.0))


def _ground(layout: StreetLayout) -> Quads:
    """Fields around the street, without the rectangle of houses and roads."""
    p = layout.parameters
    half_x = 0.5 * p.length_m + CROSS_ROAD_M + 2 * CROSS_SIDEWALK_M + HOUSE_DEPTH_M
    longer_m = longer_by_m(layout)
    angle = np.linspace(0, 2 * np.pi, 97 if longer_m == 0 else 385)
    radius = np.concatenate([np.linspace(0, 160, 33), np.geomspace(172, _GROUND_RADIUS_M, 10)])
    stretch = 1 + longer_m / _GROUND_RADIUS_M
    x, y = stretch * radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)
    ground = surface(x, y, -0.3, (0.10, 0.115, 0.06), Label.TERRAIN)
    center = ground.centers[:, :2]
    ground = ground.tinted((0.7 + 0.6 * layered_noise(center, 26.0, p.seed + 71))[:, None])
    built = (np.abs(center[:, 0]) < half_x - 3) & (np.abs(center[:, 1]) < p.front_y_m + HOUSE_DEPTH_M - 3)
    if longer_m > 0:  # wide cells next to the houses would reach into the street
        aside = np.abs(ground.corners[:, :, 1]).min(axis=1)
        built |= (np.abs(center[:, 0]) < half_x) & (aside < p.front_y_m + 2 * HOUSE_DEPTH_M)
    return ground.take(~built)


def _hills(radius: float, k: int, seed: int, longer_m: float) -> Quads:
    """A ring of woods, hazier with distance."""
    angle = np.linspace(0, 2 * np.pi, 181)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    crest = 9.0 + 14 * k + 24 * layered_noise(ring * radius, 95.0, seed + 80 + k, 3)
    crest += 5 * layered_noise(ring * radius, 14.0, seed + 90 + k, 2)
    crest[-1] = crest[0]
    rows = np.array([0.0, 0.3, 0.55, 0.75, 0.9, 1.0])
    away = radius + 30 * rows
    x, y, z = (away + longer_m) * ring[:, :1], away * ring[:, 1:], crest[:, None] * rows - 1.0
    woods = (np.array([0.075, 0.11, 0.05]), np.array([0.13, 0.17, 0.16]))[k]
    hills = surface(x, y, z, woods, Label.VEGETATION, flipped=True, closed=True)
    return hills.tinted((0.75 + 0.5 * layered_noise(hills.centers, 12.0, seed + 95))[:, None])
