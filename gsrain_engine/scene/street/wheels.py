"""Wheels of cars and trucks: a dish of metal in a tyre, seen from outside."""

import numpy as np

from .grids import patch
from .labels import Label
from .quads import Quads

TYRE = (0.018, 0.018, 0.019)
RIM = (0.36, 0.36, 0.37)


def build_wheel(radius: float, sides: int, dish: float = 0.0) -> Quads:
    """Build the right-hand side of a wheel around its hub: the outside faces -y, the tread runs inwards to +0.19 m.

    `dish` is how far the rim lies inside the tyre, in metres: trucks' twin wheels are hollow.
    """
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    radii = np.array([0.0, 0.06, 0.13, 0.205, 0.225, 0.275, 0.315, 0.32])
    radii = radii * radius / 0.32
    depth = np.array([0.035, 0.035, 0.03, 0.02, 0.0, 0.0, 0.012, 0.19])
    depth = depth + dish * np.array([0.8, 1.0, 1.0, 1.0, 0, 0, 0, 0])
    ring = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    points = radii[None, :, None] * ring[:, None] - depth[None, :, None] * np.array([0, -1.0, 0])
    spokes = (np.arange(sides) % 4 < 2)[:, None]
    ringed = np.arange(len(radii) - 1)[None]
    metal = np.where(ringed == 0, 0.9, np.where(spokes & (ringed < 3), 1.0, np.where(ringed == 3, 0.95, 0.16)))
    albedo = np.where((ringed < 4)[..., None], metal[..., None] * np.asarray(RIM), TYRE)
    albedo = np.broadcast_to(albedo, (sides, len(radii) - 1, 3)).reshape(-1, 3)
    return patch(points, albedo, Label.CAR, closed=True, sky_access=0.6, gloss=0.04)
