"""The carriageway: asphalt, lane markings, zebra crossings, and the streets that cross at the ends."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float64

from .grids import even_lines, graded_lines, panel
from .labels import Label
from .layout import CROSS_LENGTH_M, CROSS_PAVEMENT_M, CROSS_ROAD_M, StreetLayout
from .noise import layered_noise, smooth_noise
from .parking import CROSSING_LENGTH_M
from .quads import Quads

_X, _Y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
_ASPHALT = np.array([0.088, 0.088, 0.090])
_PAINT = np.array([0.50, 0.50, 0.48])
_DASH_M, _PERIOD_M = 3.0, 7.5
_STEP_M = 0.3
"""Cells along the street; dashes begin and end on multiples of it."""
_STOP_LINE_M = 0.42
_SEAM_M = 0.035


def build_road(layout: StreetLayout) -> Quads:
    """Build the road between the kerbs and the crossing streets, at z = 0."""
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
    y = graded_lines([-w, -w + 0.1, *seams[:2], -0.06, 0.06, *seams[2:], w - 0.1, w], 0.05, 0.25)
    first = np.ceil(x0 / _STEP_M - 1e-6) * _STEP_M
    inner = np.arange(first, x1 + 1e-6, _STEP_M)
    lines = np.unique(np.round(np.concatenate([[x0, x1], inner[(inner > x0 + 0.1) & (inner < x1 - 0.1)]]), 6))
    ends = [c - 1.0 for c in layout.crossings if abs(c - x1) < 1e-6]
    for end in ends:  # the stop line before a crossing has rows of its own
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
    """Where the asphalt was laid in another day's work: tarred joints across both lanes."""
    rng = np.random.default_rng([layout.parameters.seed, 13, round(10 * x0) + 10_000])
    places = np.cumsum(rng.uniform(7.0, 19.0, 40)) + x0
    return [float(x) + 0.11 for x in np.floor(places / _STEP_M) * _STEP_M if x < x1 - 6.0]


def _crossing(layout: StreetLayout, x: float) -> Quads:
    """Build a zebra crossing, kerb to kerb: stripes of half a metre along the driving direction."""
    edge = layout.parameters.kerb_y_m
    count = int(np.floor(edge / 0.5))
    stops = [float(y) for y in np.arange(-count, count + 1) * 0.5]
    breaks = [-edge, *stops, edge] if edge - stops[-1] > 1e-6 else stops
    y = graded_lines(breaks, 0.07, 0.16)
    lines = graded_lines([x, x + CROSSING_LENGTH_M], 0.1, _STEP_M)
    road = panel((0, 0, 0), _X, _Y, lines, y, _ASPHALT, Label.ROAD)
    stripe = np.floor(road.centers[:, 1] / 0.5).astype(int) % 2 == 0
    return _painted(road, stripe & (np.abs(road.centers[:, 1]) < stops[-1]))


def _parking(layout: StreetLayout, x0: float, x1: float, side: int) -> Quads:
    """Build a parking lane with its gutter; bays are told apart by short white marks."""
    p = layout.parameters
    inner, outer = p.lane_width_m, p.kerb_y_m
    y = np.append(graded_lines([inner, outer - 0.3, outer], 0.12, 0.3), outer + 0.1)  # a little under the kerb
    marks = [float(m) for m in np.arange(p.start_x_m + 3.0, p.end_x_m, 6.1) if x0 + 1 < m < x1 - 1]
    lines = graded_lines([x0, *[e for m in marks for e in (m - 0.06, m + 0.06)], x1], 0.12, 0.34)
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
    """Give the asphalt its grain, wheel tracks, repairs and oil stains, and wear to the paint."""
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
    """Where trenches were filled with darker asphalt: 1 inside, 0 outside."""
    p = layout.parameters
    rng = np.random.default_rng([p.seed, 12])
    inside = np.zeros(len(center))
    for _ in range(14):
        x = np.round(rng.uniform(p.start_x_m, p.end_x_m) / _STEP_M) * _STEP_M
        y = rng.uniform(-p.lane_width_m, p.lane_width_m - 1.0)
        length, width = _STEP_M * rng.integers(5, 26), rng.uniform(0.7, 1.6)
        inside[(center[:, 0] > x) & (center[:, 0] < x + length) & (center[:, 1] > y) & (center[:, 1] < y + width)] = 1
    return inside


def _cross_street(layout: StreetLayout, end: int) -> Quads:
    """Build the street that crosses at the end (1) or behind the start (-1), kerb to kerb."""
    p = layout.parameters
    near = p.end_x_m if end > 0 else p.start_x_m
    x0 = near + end * CROSS_PAVEMENT_M
    x1 = x0 + end * CROSS_ROAD_M
    low, high = min(x0, x1), max(x0, x1)
    mouth_low, mouth_high = min(near, x0), max(near, x0)
    x = even_lines(low, high, 0.5)
    y = even_lines(-CROSS_LENGTH_M, CROSS_LENGTH_M, 0.8)
    mouth = panel(
        (0, 0, 0), _X, _Y, even_lines(mouth_low, mouth_high, _STEP_M), even_lines(-p.kerb_y_m, p.kerb_y_m, 0.35),
        _ASPHALT, Label.ROAD,
    )  # fmt: skip
    road = Quads.joined([mouth, panel((0, 0, 0), _X, _Y, x, y, _ASPHALT, Label.ROAD)])
    center = road.centers[:, :2].astype(np.float64)
    clouds = layered_noise(center, 1.8, p.seed + 51, 4)
    return road.tinted((0.83 + 0.34 * clouds)[:, None])
