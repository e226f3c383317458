"""Street furniture: lamps, signs, bollards, bins and benches."""

from dataclasses import replace

import numpy as np

from .grids import box, patch, tube
from .labels import Label
from .layout import KERB_HEIGHT_M, StreetLayout
from .parking import CROSSING_LENGTH_M
from .quads import Quads

_IRON = (0.045, 0.055, 0.052)
_STEEL = (0.24, 0.245, 0.25)
_BEFORE_POLE_M = 0.05
"""How far in front of its pole a sign hangs."""


def build_furniture(layout: StreetLayout) -> Quads:
    """Build everything that stands on the pavements, in the world."""
    p = layout.parameters
    parts = [_lamp(x, y) for x, y in layout.lamps]
    beside = p.kerb_y_m + 0.32
    for c in layout.crossings:
        for side, x in ((-1, c - 0.6), (1, c + CROSSING_LENGTH_M + 0.6)):
            parts.append(_crossing_sign(x, side * beside, side))
        for side in (-1, 1):
            for k in range(3):
                parts.append(_bollard(c + 0.3 + 1.2 * k, side * (p.kerb_y_m + 0.4)))
    rng = np.random.default_rng([p.seed, 5])
    for x in np.arange(p.start_x_m + 14.0, p.end_x_m - 8, 27.0):
        side = 1 if rng.random() < 0.5 else -1
        parts.append(_bin(float(x), side * (p.kerb_y_m + 0.55)))
    for x in np.arange(p.start_x_m + 25.0, p.end_x_m - 8, 48.0):
        parts.append(_speed_sign(float(x), -beside))
    return Quads.joined(parts)


def _pole(
    x: float, y: float, height: float, radius: float, albedo: tuple[float, float, float], sides: int = 7
) -> Quads:
    z = np.concatenate([[0.0, 0.06, 0.14], np.arange(0.3, height - 0.1, 0.32), [height]])
    path = np.stack([np.full_like(z, x), np.full_like(z, y), KERB_HEIGHT_M + z], axis=1)
    swell = 1 + 0.9 * np.exp(-((z / 0.7) ** 4)) if radius > 0.05 else np.ones_like(z)
    return tube(path, radius * swell * (1 - 0.25 * z / height), albedo, Label.POLE, sides=sides, gloss=0.06)


def _lamp(x: float, y: float) -> Quads:
    """A lantern on a curved arm over the road, 6.5 m high."""
    inward = -float(np.sign(y))
    turn = np.linspace(0, 0.5 * np.pi, 7)
    arm = np.stack(
        [np.full_like(turn, x), y + inward * 1.5 * (1 - np.cos(turn)), KERB_HEIGHT_M + 5.8 + 0.75 * np.sin(turn)],
        axis=1,
    )
    head_y, head_z = y + inward * 1.75, KERB_HEIGHT_M + 6.55
    return Quads.joined(
        [
            _pole(x, y, 5.82, 0.075, _IRON),
            tube(arm, np.linspace(0.05, 0.04, 7), _IRON, Label.POLE, sides=6, gloss=0.06),
            box((x, head_y, head_z + 0.02), (0.24, 0.62, 0.1), _IRON, Label.POLE, edge=0.06, coarse=0.16),
            box((x, head_y, head_z - 0.06), (0.18, 0.5, 0.05), (0.6, 0.6, 0.55), Label.POLE, edge=0.06, coarse=0.16,
                faces="xXyYz"),
        ]
    )  # fmt: skip


def _round_sign(x: float, y: float, z: float, size: float) -> Quads:
    """A speed limit that faces along -x: a red ring around two digits."""
    angle = np.linspace(0, -2 * np.pi, 25)
    radii = 0.5 * size * np.array([0.0, 0.25, 0.5, 0.76, 0.88, 1.0])
    across, up = radii[None] * np.sin(angle)[:, None], radii[None] * np.cos(angle)[:, None]
    face = patch(np.stack(np.broadcast_arrays(x - _BEFORE_POLE_M, y + across, z + up), axis=2), 0.72, Label.SIGN)
    center = face.centers - np.array([x, y, z], np.float32)
    ring = np.hypot(center[:, 1], center[:, 2]) > 0.37 * size
    digits = (np.abs(np.abs(center[:, 1]) - 0.13 * size) < 0.07 * size) & (np.abs(center[:, 2]) < 0.2 * size)
    colors = np.where(ring[:, None], [0.55, 0.015, 0.02], np.where(digits[:, None], 0.03, 0.72))
    return _with_back(replace(face, albedo=colors.astype(np.float32)))


def _square_sign(x: float, y: float, z: float, size: float, facing: int) -> Quads:
    """A crossing sign that faces along +x (facing 1) or -x (-1): a white triangle with a dark figure, on blue."""
    lines = np.linspace(-0.5, 0.5, 13) * size
    across = facing * lines[:, None]
    points = np.stack(np.broadcast_arrays(x + facing * _BEFORE_POLE_M, y + across, z + lines[None]), axis=2)
    face = patch(points, 0.0, Label.SIGN)
    u, v = ((face.centers[:, 1:] - np.array([y, z], np.float32)) / size).T
    triangle = (v > -0.34) & (np.abs(u) < 0.42 * (0.36 - v) / 0.7)
    figure = (np.abs(u) < 0.07) & (v > -0.25) & (v < 0.1)
    colors = np.where((triangle & ~figure)[:, None], 0.72, np.array([0.015, 0.07, 0.32]))
    return _with_back(replace(face, albedo=colors.astype(np.float32)))


def _with_back(face: Quads) -> Quads:
    """Put a grey back behind a sign's face, one centimetre away."""
    corners = face.corners[:, ::-1] - np.float32(0.01) * face.normals[:, None]
    return Quads.joined([face, Quads.of(corners, 0.3, Label.SIGN, spread=face.spread)])


def _crossing_sign(x: float, y: float, side: int) -> Quads:
    return Quads.joined([_pole(x, y, 2.95, 0.033, _STEEL, 6), _square_sign(x, y, 2.75, 0.62, side)])


def _speed_sign(x: float, y: float) -> Quads:
    return Quads.joined([_pole(x, y, 2.75, 0.033, _STEEL, 6), _round_sign(x, y, 2.6, 0.6)])


def _bollard(x: float, y: float) -> Quads:
    z = np.array([0.0, 0.1, 0.3, 0.5, 0.68, 0.78, 0.86, 0.92, 0.96])
    radii = np.array([0.085, 0.07, 0.062, 0.06, 0.06, 0.06, 0.068, 0.055, 0.005])
    path = np.stack([np.full_like(z, x), np.full_like(z, y), KERB_HEIGHT_M + z], axis=1)
    body = tube(path, radii, _IRON, Label.FURNITURE, sides=8, gloss=0.05)
    band = (body.centers[:, 2] - KERB_HEIGHT_M > 0.68) & (body.centers[:, 2] - KERB_HEIGHT_M < 0.78)
    albedo = np.where(band[:, None], 0.6, body.albedo)
    return Quads.of(body.corners, albedo, Label.FURNITURE, spread=body.spread, gloss=0.05)


def _bin(x: float, y: float) -> Quads:
    z = np.array([0.05, 0.12, 0.3, 0.5, 0.7, 0.82, 0.9, 0.97, 1.0])
    radii = np.array([0.2, 0.22, 0.23, 0.235, 0.24, 0.25, 0.25, 0.18, 0.01])
    path = np.stack([np.full_like(z, x), np.full_like(z, y), KERB_HEIGHT_M + z], axis=1)
    body = tube(path, radii, (0.035, 0.085, 0.05), Label.FURNITURE, sides=14, gloss=0.05)
    towards_road = (body.centers[:, 1] - y) * np.sign(y) < 0
    slot = towards_road & (np.abs(body.centers[:, 2] - KERB_HEIGHT_M - 0.76) < 0.06)
    return body.tinted(np.where(slot, 0.25, 1.0)[:, None])
