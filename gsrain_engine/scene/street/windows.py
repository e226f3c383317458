"""Windows and doors in the frame of a house front: x along it, y into the house, z up."""

from typing import Any

import numpy as np

from .grids import box, even_lines, graded_lines, panel
from .labels import Label
from .quads import Quads

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
REVEAL_M = 0.17
"""How deep frames lie behind the wall."""
TRIM_M = 0.11
"""Width of the stone surround."""
_FRAME = 0.065
_GLOSS = 0.5


def strip(x0: float, x1: float, z0: float, z1: float, y: float, albedo: Any, step: float, **more: Any) -> Quads:
    """Make a narrow upright rectangle that faces the street: one or two cells across, long cells along."""
    wide = x1 - x0 > z1 - z0
    across = z1 - z0 if wide else x1 - x0
    cells = 1 if across < 0.12 else 2
    x = graded_lines([x0, x1], 0.1, step) if wide else np.linspace(x0, x1, cells + 1)
    z = np.linspace(z0, z1, cells + 1) if wide else graded_lines([z0, z1], 0.1, step)
    return panel((0, y, 0), _X, _Z, x, z, albedo, Label.BUILDING, **more)


def opening(width: float, height: float, wall: Any, step: float, deep: float = REVEAL_M) -> Quads:
    """Make the sides of a hole in the wall: left, right and upper reveal and the sill, 0 to `deep` behind the wall."""
    y = np.array([0.0, deep])
    x, z = even_lines(0.0, width, step), even_lines(0.0, height, step)
    shade = {"sky_access": 0.55}
    return Quads.joined(
        [
            panel((0, 0, 0), _Y, _Z, y, z, wall, Label.BUILDING, **shade),
            panel((width, 0, 0), _Z, _Y, z, y, wall, Label.BUILDING, **shade),
            panel((0, 0, height), _Y, _X, y, x, wall, Label.BUILDING, sky_access=0.3),
            panel((0, 0, 0), _X, _Y, x, y, wall, Label.BUILDING, sky_access=0.7),
        ]
    )


def glass(x0: float, x1: float, z0: float, z1: float, y: float, curtain: float, coarse: float) -> Quads:
    """Make a pane: a dark room behind it, curtains at its sides (0: none, 1: drawn), a mirrored street on it."""
    pane = panel(
        (0, y, 0), _X, _Z, graded_lines([x0, x1], 0.08, coarse), graded_lines([z0, z1], 0.08, coarse), 0.02,
        Label.BUILDING, gloss=_GLOSS, sky_access=0.8,
    )  # fmt: skip
    center = pane.centers
    sideways = np.abs(center[:, 0] - 0.5 * (x0 + x1)) / (0.5 * (x1 - x0))
    upwards = (center[:, 2] - z0) / (z1 - z0)
    room = 0.012 + 0.03 * upwards**2
    hung = sideways > 1.15 - curtain
    albedo = np.where(hung[:, None], [0.34, 0.33, 0.30], room[:, None] * np.array([1.0, 0.97, 0.9]))
    return Quads.of(pane.corners, albedo, Label.BUILDING, gloss=_GLOSS, sky_access=0.75, spread=pane.spread)


def window(
    width: float, height: float, wall: Any, trim: Any, frame: Any, curtain: float, detail: float, sill: bool = True
) -> Quads:
    """Make a two-winged window with its surround; origin at the lower left corner of the hole, at the wall.

    The surround reaches `TRIM_M` beyond the hole on every side but the lower one, where the sill is.
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
    left, right = (_FRAME, middle - 0.045), (middle + 0.045, width - _FRAME)
    for x0, x1 in (left, right):
        if height > 1.4:
            parts.append(strip(x0, x1, bar - 0.03, bar + 0.03, y - 0.03, frame, step, sky_access=0.8))
            parts.append(glass(x0, x1, bar + 0.03, height - _FRAME, y, min(curtain, 0.9), coarse))
            parts.append(glass(x0, x1, _FRAME, bar - 0.03, y, curtain, coarse))
        else:
            parts.append(glass(x0, x1, _FRAME, height - _FRAME, y, curtain, coarse))
    if sill:
        parts.append(
            box((middle, -0.04, -0.045), (width + 2 * t, 0.10, 0.09), trim, Label.BUILDING, edge=0.1, coarse=0.5,
                faces="yZ")
        )  # fmt: skip
    return Quads.joined(parts)


def far_window(width: float, height: float, wall: Any, trim: Any, frame: Any, curtain: float, detail: float) -> Quads:
    """Make a window for houses that are never seen from near: the same look, without depth; origin as for `window`."""
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
    parts = [
        Quads.of(
            flat.corners, albedo, Label.BUILDING, gloss=np.where(wood, 0.0, _GLOSS), sky_access=0.75, spread=flat.spread
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
        parts.append(Quads.of(pane.corners, albedo, Label.BUILDING, gloss=0.5, sky_access=0.8, spread=pane.spread))
    return Quads.joined(parts)


def door(width: float, height: float, wall: Any, color: Any, detail: float) -> Quads:
    """Make a panelled door with a light above it; origin at the lower left corner of the hole, at the wall."""
    deep = 0.28
    top = min(height - 0.12, 2.15)
    wood = np.asarray(color, np.float64)
    x = graded_lines([0.0, 0.1, 0.5 * width - 0.06, 0.5 * width + 0.06, width - 0.1, width], 0.1, 0.3)
    z = graded_lines([0.0, 0.16, 0.95, 1.1, top - 0.14, top], 0.1, 0.5 * detail)
    leaf = panel((0, deep, 0), _X, _Z, x, z, wood, Label.BUILDING, gloss=0.12, sky_access=0.6)
    center = leaf.centers
    inset = (np.abs(center[:, 0] - 0.5 * width) > 0.06) & (np.abs(center[:, 0] - 0.5 * width) < 0.5 * width - 0.1)
    inset &= ((center[:, 2] > 0.16) & (center[:, 2] < 0.95)) | ((center[:, 2] > 1.1) & (center[:, 2] < top - 0.14))
    leaf = leaf.tinted(np.where(inset, 0.6, 1.15)[:, None])
    brass = (0.5, 0.42, 0.25)
    knob = (0.5 * width + 0.1, deep - 0.04, 1.02)
    handle = box(knob, (0.05, 0.06, 0.18), brass, Label.BUILDING, edge=0.06, gloss=0.3)
    return Quads.joined(
        [
            opening(width, height, wall, 0.5 * detail, deep),
            leaf,
            handle,
            strip(0.0, width, top, top + 0.08, deep, wood * 1.2, 0.3, sky_access=0.5),
            glass(0.0, width, top + 0.08, height, deep, 0.0, 0.3),
        ]
    )
