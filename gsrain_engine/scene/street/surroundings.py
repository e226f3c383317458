"""What lies behind the houses: ground, and wooded hills that close the horizon."""

import numpy as np

from .grids import patch
from .labels import Label
from .layout import CROSS_PAVEMENT_M, CROSS_ROAD_M, HOUSE_DEPTH_M, StreetLayout
from .noise import layered_noise
from .quads import Quads

_GROUND_RADIUS_M = 420.0
_HILLS_AT_M = (260.0, 380.0)


def build_surroundings(layout: StreetLayout) -> Quads:
    """Build the ground around the street and two ranges of hills, in the world."""
    p = layout.parameters
    middle = np.array([0.5 * (p.start_x_m + p.end_x_m), 0.0, 0.0])
    parts = [_ground(layout)]
    parts += [_hills(radius, k, p.seed) for k, radius in enumerate(_HILLS_AT_M)]
    return Quads.joined(parts).placed(middle)


def _ground(layout: StreetLayout) -> Quads:
    """Fields around the street; the rectangle that houses and roads cover is left out."""
    p = layout.parameters
    half_x = 0.5 * p.length_m + CROSS_ROAD_M + 2 * CROSS_PAVEMENT_M + HOUSE_DEPTH_M
    angle = np.linspace(0, 2 * np.pi, 97)
    radius = np.concatenate([np.linspace(0, 160, 33), np.geomspace(172, _GROUND_RADIUS_M, 10)])
    points = np.stack(
        np.broadcast_arrays(radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle), -0.3), axis=2
    )
    ground = patch(points, (0.10, 0.115, 0.06), Label.TERRAIN)
    center = ground.centers[:, :2]
    ground = ground.tinted((0.7 + 0.6 * layered_noise(center, 26.0, p.seed + 71))[:, None])
    built = (np.abs(center[:, 0]) < half_x - 3) & (np.abs(center[:, 1]) < p.front_y_m + HOUSE_DEPTH_M - 3)
    return ground.take(~built)


def _hills(radius: float, k: int, seed: int) -> Quads:
    """A ring of woods, hazier the farther away."""
    angle = np.linspace(0, 2 * np.pi, 181)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    crest = 9.0 + 14 * k + 24 * layered_noise(ring * radius, 95.0, seed + 80 + k, 3)
    crest += 5 * layered_noise(ring * radius, 14.0, seed + 90 + k, 2)
    crest[-1] = crest[0]
    rows = np.array([0.0, 0.3, 0.55, 0.75, 0.9, 1.0])
    away = radius + 30 * rows
    points = np.stack(np.broadcast_arrays(away * ring[:, :1], away * ring[:, 1:], crest[:, None] * rows - 1.0), axis=2)[
        ::-1
    ]
    woods = (np.array([0.075, 0.11, 0.05]), np.array([0.13, 0.17, 0.16]))[k]
    hills = patch(points, woods, Label.VEGETATION, closed=True)
    return hills.tinted((0.75 + 0.5 * layered_noise(hills.centers, 12.0, seed + 95))[:, None])
