"""Bicycles: wheels with spokes, frame, handlebar, saddle, and a cyclist on one.

The object frame has x forward, y left, z up, and its origin on the ground below the bottom bracket.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from gsrain_engine.scene.labels import Label

from .layout import Color, StreetLayout
from .mesh import EDGE_SPREAD, Quads, box, patch, tube
from .people import CYCLIST, build_person
from .solids import Point

BICYCLE_SIZE_M = 1.78, 0.62, 1.12
"""Length, width and height without the cyclist; with one it is `CYCLIST`'s height on the saddle."""
CYCLIST_SIZE_M = 1.76, 0.66, 1.81
_WHEEL_M = 0.345
_REAR, _FRONT = (-0.46, 0.0, _WHEEL_M), (0.60, 0.0, _WHEEL_M)
_BRACKET, _SEAT, _HEAD, _CROWN = (0.0, 0.0, 0.29), (-0.17, 0.0, 0.86), (0.40, 0.0, 0.90), (0.435, 0.0, 0.72)
_TIRE: Color = (0.014, 0.014, 0.015)
_STEEL: Color = (0.34, 0.34, 0.35)
_BLACK: Color = (0.016, 0.016, 0.017)
_SPOKES = 20


def build_bicycle(paint: Color) -> Quads:
    """Build a city bicycle, its pedals level."""
    parts = [_wheel(_REAR), _wheel(_FRONT), _frame(paint), _drive_train(), _fittings(paint)]
    return replace(Quads.joined(parts), labels=np.full(sum(map(len, parts)), Label.BICYCLE, np.uint8))


def build_waiting_bicycles(layout: StreetLayout) -> Quads:
    """Build the bicycles of those who wait on the street, in the world."""
    return Quads.joined(
        build_bicycle(each.paint).placed((each.x, each.y, 0.0), each.turn_deg) for each in layout.cyclists
    )


def build_cyclist(paint: Color, sun: Float64[np.ndarray, "3"] | None = None, *, stopped: bool = False) -> Quads:
    """Build a bicycle with its rider, who pedals, or has the right foot on a curb."""
    rider = replace(CYCLIST, stance="stopped") if stopped else CYCLIST
    return Quads.joined([build_bicycle(paint), build_person(rider, sun)])


def _wheel(hub: Point) -> Quads:
    turn = np.linspace(0, 2 * np.pi, 37)
    circle = np.stack([np.cos(turn), np.zeros_like(turn), np.sin(turn)], axis=1)

    def ring(radius: float, thickness: float, albedo: Color, gloss: float) -> Quads:
        around = np.linspace(0, 2 * np.pi, 7)
        radii = radius + thickness * np.cos(around)
        points = radii[None, :, None] * circle[:, None]
        points[..., 1] = thickness * np.sin(around)
        return patch(points + np.array(hub), albedo, Label.BICYCLE, closed=True, spread=_ROUND, gloss=gloss)

    tire, rim = ring(_WHEEL_M - 0.019, 0.019, _TIRE, 0.02), ring(_WHEEL_M - 0.045, 0.010, _STEEL, 0.12)
    axle = _rod([(hub[0], -0.07, hub[2]), (hub[0], 0.07, hub[2])], 0.024, _STEEL, sides=7)
    # Each spoke is a ribbon of 3 mm, which faces both sides.
    angle = 2 * np.pi * np.arange(_SPOKES) / _SPOKES
    outward = np.stack([np.cos(angle), np.zeros(_SPOKES), np.sin(angle)], axis=1)
    across = 0.0015 * np.stack([-np.sin(angle), np.zeros(_SPOKES), np.cos(angle)], axis=1)
    inner, outer = 0.02 * outward, (_WHEEL_M - 0.05) * outward
    side = 0.02 * (-1.0) ** np.arange(_SPOKES)[:, None] * np.array([0.0, 1.0, 0.0])
    corners = np.stack([inner + side - across, outer - across, outer + across, inner + side + across], axis=1)
    spokes = Quads.of(corners + np.array(hub), _STEEL, Label.BICYCLE, spread=(0.4, 0.5), gloss=0.1)
    return Quads.joined([tire, rim, axle, spokes])


_ROUND = (0.6, EDGE_SPREAD)


def _rod(path: Sequence[Point], radius: float, albedo: Color, sides: int = 6, gloss: float = 0.1) -> Quads:
    return tube(np.array(path), np.full(len(path), radius), albedo, Label.BICYCLE, sides=sides, gloss=gloss)


def _straight(a: Point, b: Point, radius: float, albedo: Color, count: int = 7) -> Quads:
    path = np.linspace(a, b, count)
    return tube(path, np.full(count, radius), albedo, Label.BICYCLE, sides=7, gloss=0.14)


def _frame(paint: Color) -> Quads:
    parts = [
        _straight(_BRACKET, _SEAT, 0.016, paint), _straight(_BRACKET, _CROWN, 0.019, paint),
        _straight((-0.15, 0, 0.80), (0.405, 0, 0.87), 0.016, paint), _straight(_CROWN, _HEAD, 0.020, paint, 4),
        _straight(_SEAT, (-0.195, 0, 0.95), 0.013, _STEEL, 4), _straight(_HEAD, (0.385, 0, 1.01), 0.013, _STEEL, 4),
    ]  # fmt: skip
    for y in (-0.05, 0.05):
        parts += [
            _straight((0.0, 0.4 * y, 0.29), (-0.46, y, _WHEEL_M), 0.010, paint),
            _straight((-0.15, 0.3 * y, 0.80), (-0.46, y, _WHEEL_M), 0.008, paint),
            _straight((0.437, 0.8 * y, 0.715), (0.60, y, _WHEEL_M), 0.012, paint),
        ]
    return Quads.joined(parts)


def _drive_train() -> Quads:
    turn = np.linspace(0, 2 * np.pi, 19)
    disc = np.stack([0.085 * np.cos(turn), np.full_like(turn, -0.055), 0.29 + 0.085 * np.sin(turn)], axis=1)
    bracket = np.array(_BRACKET)
    inner = bracket + (disc - bracket) * [0.55, 1.0, 0.55]
    chain_ring = patch(np.stack([disc, inner], axis=1), _STEEL, Label.BICYCLE, closed=True, gloss=0.1)
    chain = [
        _rod([(x0, -0.055, z0), (0.5 * (x0 + x1), -0.055, 0.5 * (z0 + z1)), (x1, -0.055, z1)], 0.006, _BLACK, 4)
        for x0, z0, x1, z1 in ((0.0, 0.375, -0.46, 0.385), (0.0, 0.205, -0.46, 0.305))
    ]
    parts = [chain_ring, *chain]
    for side, x, z in ((1, 0.14, 0.39), (-1, 0.0, 0.125)):  # as the cyclist's feet are
        y = 0.075 * side
        parts.append(_rod([(0.0, y, 0.29), (0.5 * x, y, 0.5 * (0.29 + z)), (x, y, z)], 0.010, _STEEL, 5))
        parts.append(box((x, 0.125 * side, z), (0.09, 0.09, 0.022), _BLACK, Label.BICYCLE, faces="xXyYzZ"))
    return Quads.joined(parts)


def _fittings(paint: Color) -> Quads:
    """Handlebar with grips, saddle, mudguards, rack, lamps and reflectors."""
    bar = [(0.45, -0.30, 1.06), (0.41, -0.22, 1.045), (0.40, -0.08, 1.02), (0.40, 0.0, 1.015), (0.40, 0.08, 1.02),
           (0.41, 0.22, 1.045), (0.45, 0.30, 1.06)]  # fmt: skip
    x = np.linspace(-0.34, -0.06, 8)
    wide = np.interp(x, [-0.34, -0.27, -0.18, -0.06], [0.055, 0.075, 0.040, 0.016])
    across = np.linspace(-1, 1, 6)
    saddle_z = 0.985 - 0.018 * (across**2)[None] - 0.06 * np.clip(x[:, None] + 0.10, 0, 1)
    saddle = patch(
        np.stack(np.broadcast_arrays(x[:, None], wide[:, None] * across, saddle_z), axis=2), _BLACK, Label.BICYCLE,
        gloss=0.06,
    )  # fmt: skip
    skirt = patch(
        np.stack([np.stack([x, -wide, np.full_like(x, 0.967)], 1), np.stack([x, -wide, np.full_like(x, 0.93)], 1)], 1),
        _BLACK, Label.BICYCLE,
    )  # fmt: skip
    parts = [_rod(bar, 0.013, _STEEL), saddle, skirt, skirt.mirrored()]
    parts += [_rod([(0.43, s * 0.24, 1.05), (0.45, s * 0.30, 1.06)], 0.018, _BLACK) for s in (-1, 1)]
    for hub, start, stop in ((_REAR, 0.15, 1.05), (_FRONT, 0.1, 0.72)):
        turn = np.pi * np.linspace(start, stop, 14)
        radius = _WHEEL_M + 0.022
        x, z = hub[0] + radius * np.cos(turn), hub[2] + radius * np.sin(turn)
        y = np.array([-0.028, 0.0, 0.028])
        points = np.stack(np.broadcast_arrays(x[:, None], y, z[:, None] - 0.006 * (y / 0.028) ** 2), axis=2)
        parts.append(patch(points[:, ::-1], paint, Label.BICYCLE, gloss=0.12))
    rack = [(-0.62, y, 0.74) for y in (-0.06, 0.06)]
    for x0, y, z in rack:
        parts.append(_rod([(x0, y, z), (-0.42, y, z), (-0.18, y, z)], 0.007, _BLACK, 5))
        parts.append(_rod([(-0.46, y, 0.36), (-0.50, y, 0.55), (-0.52, y, z)], 0.006, _BLACK, 5))
    parts.append(box((-0.62, 0.0, 0.70), (0.03, 0.09, 0.05), (0.42, 0.006, 0.006), Label.BICYCLE, faces="xyYZz"))
    parts.append(box((0.46, 0.0, 0.86), (0.06, 0.06, 0.06), _BLACK, Label.BICYCLE, faces="xyYZz"))
    parts.append(box((0.492, 0.0, 0.86), (0.006, 0.05, 0.05), (0.8, 0.8, 0.78), Label.BICYCLE, faces="X", gloss=0.3))
    return Quads.joined(parts)
