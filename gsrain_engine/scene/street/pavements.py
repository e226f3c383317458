"""Pavements with kerbs of granite, concrete slabs and tree pits."""

from dataclasses import replace

import numpy as np

from .grids import even_lines, graded_lines, panel
from .labels import Label
from .layout import CROSS_LENGTH_M, CROSS_PAVEMENT_M, CROSS_ROAD_M, HOUSE_DEPTH_M, KERB_HEIGHT_M, StreetLayout
from .noise import lattice_noise, layered_noise
from .parking import CROSSING_LENGTH_M
from .quads import Quads

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_SLAB = np.array([0.235, 0.225, 0.205])
_GRANITE = np.array([0.30, 0.295, 0.285])
_SOIL = np.array([0.075, 0.05, 0.032])
KERB_WIDTH_M = 0.15


def build_pavements(layout: StreetLayout) -> Quads:
    """Build both pavements of the street and those of the crossing streets."""
    parts = [_side(layout, side) for side in (1, -1)]
    parts += [_across(layout, end) for end in (1, -1)]
    return Quads.joined(parts)


def _side(layout: StreetLayout, side: int) -> Quads:
    p = layout.parameters
    kerb, front = p.kerb_y_m, p.front_y_m
    x = even_lines(p.start_x_m, p.end_x_m, 0.5)
    x_soft = even_lines(p.start_x_m, p.end_x_m, 0.6)
    y_slabs = np.append(np.arange(kerb + KERB_WIDTH_M, front - 0.2, 0.5), [front, front + 0.2])
    slabs = _level(x, y_slabs, side, _SLAB, Label.PAVEMENT, KERB_HEIGHT_M)
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
    top = _level(x_soft, np.linspace(kerb, kerb + KERB_WIDTH_M, 3), side, _GRANITE, Label.PAVEMENT, KERB_HEIGHT_M)
    face = _kerb_face(x_soft, kerb, side)
    stones = Quads.joined([top, face])
    stone = np.floor(stones.centers[:, :1].astype(np.float64) / 1.2).astype(np.int64)
    shade = 0.88 + 0.24 * lattice_noise(stone, p.seed + 63 + side)
    lowered = np.zeros(len(stones), bool)
    for c in layout.crossings:  # kerbs are painted light at crossings
        lowered |= (stones.centers[:, 0] > c) & (stones.centers[:, 0] < c + CROSSING_LENGTH_M)
    return Quads.joined([slabs, stones.tinted((shade * np.where(lowered, 1.25, 1.0))[:, None])])


def _level(x: np.ndarray, y: np.ndarray, side: int, albedo: np.ndarray, label: Label, z: float) -> Quads:
    lines = y if side > 0 else -y[::-1]
    return panel((0, 0, z), _X, _Y, x, lines, albedo, label)


def _kerb_face(x: np.ndarray, kerb: float, side: int) -> Quads:
    z = np.array([-0.06, 0.0, 0.5 * KERB_HEIGHT_M, KERB_HEIGHT_M])
    if side > 0:
        return panel((0, kerb, 0), _X, _Z, x, z, 0.9 * _GRANITE, Label.PAVEMENT, sky_access=0.75)
    return panel((0, -kerb, 0), _Z, _X, z, x, 0.9 * _GRANITE, Label.PAVEMENT, sky_access=0.75)


def _across(layout: StreetLayout, end: int) -> Quads:
    """Build the pavements along a crossing street: a whole one on the far side, two halves on the near side."""
    p = layout.parameters
    near = p.end_x_m if end > 0 else p.start_x_m
    parts: list[Quads] = []
    far = near + end * (CROSS_PAVEMENT_M + CROSS_ROAD_M)
    strips = [(far, far + end * CROSS_PAVEMENT_M, -CROSS_LENGTH_M, CROSS_LENGTH_M)]
    strips += [(near, near + end * CROSS_PAVEMENT_M, s * p.kerb_y_m, s * CROSS_LENGTH_M) for s in (1, -1)]
    for xa, xb, ya, yb in strips:
        x, y = even_lines(min(xa, xb), max(xa, xb), 0.65), even_lines(min(ya, yb), max(ya, yb), 0.65)
        flat = panel((0, 0, KERB_HEIGHT_M), _X, _Y, x, y, _SLAB, Label.PAVEMENT)
        center = flat.centers[:, :2].astype(np.float64)
        parts.append(flat.tinted((0.8 + 0.3 * layered_noise(center, 1.5, p.seed + 64, 3))[:, None]))
        z = np.array([0.0, 0.5 * KERB_HEIGHT_M, KERB_HEIGHT_M])
        kerb_x = far if xa == far else near + end * CROSS_PAVEMENT_M
        facing_minus_x = (end > 0) == (xa == far)
        face = (
            panel((kerb_x, 0, 0), _Z, _Y, z, y, _GRANITE, Label.PAVEMENT)
            if facing_minus_x
            else panel((kerb_x, 0, 0), _Y, _Z, y, z, _GRANITE, Label.PAVEMENT)
        )
        parts.append(face)
    for s in (1, -1):  # where the pavement meets the mouth of the street
        low, high = sorted((near, near + end * CROSS_PAVEMENT_M))
        parts.append(_kerb_face(graded_lines([low, high], 0.3, 0.6), p.kerb_y_m, s))
        parts.append(_yard(layout, end, s))
    return Quads.joined(parts)


def _yard(layout: StreetLayout, end: int, side: int) -> Quads:
    """Build the paved ground beside the last house of a row, along the crossing street."""
    p = layout.parameters
    near = p.end_x_m if end > 0 else p.start_x_m
    x0, x1 = sorted((near, near - end * 0.6))
    y0, y1 = sorted((side * (p.front_y_m + HOUSE_DEPTH_M), side * CROSS_LENGTH_M))
    return panel((0, 0, KERB_HEIGHT_M), _X, _Y, even_lines(x0, x1, 0.6), even_lines(y0, y1, 1.2), _SLAB, Label.PAVEMENT)
