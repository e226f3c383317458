"""The sky: a dome with a blue-to-pale gradient and soft clouds."""

from typing import Any

import numpy as np
from jaxtyping import Float, Float64

from .grids import patch
from .labels import Label
from .layout import StreetLayout
from .noise import layered_noise
from .quads import Quads

RADIUS_M = 900.0
SKY_SPREAD = 0.8
"""Wider than elsewhere: neighbouring cells of sky melt into one another."""


def build_sky(layout: StreetLayout) -> Quads:
    """Build the dome around the middle of the street, from just below the horizon to the zenith."""
    p = layout.parameters
    azimuth = np.radians(np.linspace(0, 360, 209))
    elevation = np.radians(np.concatenate([np.arange(-8, 27, 1.3), np.linspace(28, 56, 12), np.linspace(60, 90, 8)]))
    points = RADIUS_M * np.stack(
        np.broadcast_arrays(
            np.cos(elevation) * np.cos(azimuth)[:, None],
            np.cos(elevation) * np.sin(azimuth)[:, None],
            np.sin(elevation)[None],
        ),
        axis=2,
    )
    dome = patch(points[::-1], 1.0, Label.SKY, closed=True)
    middle = (0.5 * (p.start_x_m + p.end_x_m), 0.0, 0.0)
    return Quads.of(dome.corners, 1.0, Label.SKY, normals=dome.normals, opacity=0.995, spread=SKY_SPREAD).placed(middle)


def sky_display(
    directions: Float[np.ndarray, "n 3"], sun: Float64[np.ndarray, "3"], seed: int
) -> Float64[np.ndarray, "n 3"]:
    """Display colour of the sky in unit directions: paler towards the horizon and the sun, with cumulus."""
    up = np.clip(directions[:, 2], 0, 1).astype(np.float64)
    zenith, horizon = np.array([0.24, 0.44, 0.74]), np.array([0.80, 0.87, 0.93])
    part = (1 - up) ** 3.2
    color = zenith + (horizon - zenith) * part[:, None]
    glow = np.clip(directions @ sun, 0, 1) ** 6
    color = color + 0.16 * glow[:, None] * np.array([1.0, 0.93, 0.78])
    return _with_clouds(color, directions.astype(np.float64), up, seed)


def _with_clouds(color: Any, directions: Any, up: Any, seed: int) -> Any:
    """Lay clouds over the gradient: noise on a flat layer above, so that they flatten towards the horizon."""
    flat = directions[:, :2] / (up + 0.22)[:, None]
    billow = layered_noise(flat, 0.75, seed + 101, 5)
    cover = np.clip((billow - 0.50) / 0.17, 0, 1)
    cover = cover * cover * (3 - 2 * cover) * np.clip((up - 0.01) / 0.10, 0, 1)
    body = np.clip((billow - 0.55) / 0.25, 0, 1)
    white = np.array([0.965, 0.97, 0.975]) - body[:, None] * np.array([0.13, 0.11, 0.085])
    return np.clip(color + (white - color) * 0.88 * cover[:, None], 0, 1)
