"""Scenes that both GSRAIN and a path tracer draw: a drop on glass, and boxes and lamps over a wet road. Only NumPy."""

from typing import NamedTuple

import numpy as np

# A drop on the glass before a camera: camera coordinates, x right, y down, z forward, meters

DROP_PX, DROP_TANGENT = 1200, 0.6  # side of the picture, and tangent of half its field of view
DROP_WINDOW_PX = 96
"""Side of the part in the middle of the picture that is compared: the drop, and little around it."""
PANE_M, DROP_RADIUS_M, CONTACT_DEG = 0.10, 0.004, 50.0
WATER = 1.333
SKY_TANGENT = 2.5 * DROP_TANGENT
"""Largest tangent of a direction at which the surroundings change."""


def surroundings(x, y, z):
    """Linear light from directions, (..., 3); black behind the camera."""
    ahead = np.maximum(z, 1e-9)
    u, v = np.clip(x / ahead, -SKY_TANGENT, SKY_TANGENT), np.clip(y / ahead, -SKY_TANGENT, SKY_TANGENT)
    ground = 1 / (1 + np.exp(-8 * v))
    red = 0.75 - 0.55 * ground + 0.15 * np.sin(3 * u)
    green = 0.75 - 0.45 * ground + 0.15 * np.cos(4 * u + 2 * v)
    blue = 0.80 - 0.60 * ground + 0.10 * np.sin(5 * v)
    return np.where((z > 0)[..., None], np.stack([red, green, blue], axis=-1), 0.0)


# A wet road: world coordinates, z up, meters; the camera looks along x

ROAD_PX, ROAD_TANGENT = (192, 128), 0.5  # width and height, tangent of half the horizontal field of view
EYE_M, DOWN = (0.0, 0.0, 1.5), 0.12  # position, slope of the view
SLOPES = {"smooth": 0.02, "rough": 0.10}
"""Standard deviations of the slopes of standing water and of a film, as `ground_water` has them."""


class Box(NamedTuple):
    """A box that shines evenly: corners, linear light."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    light: tuple[float, float, float]


BOXES = (
    Box((9.0, -0.9, 0.0), (13.0, 0.9, 1.5), (0.55, 0.05, 0.05)),
    Box((6.0, 2.6, 0.0), (60.0, 4.0, 6.0), (0.30, 0.28, 0.22)),
    Box((10.0, -4.5, 0.0), (60.0, -3.2, 4.0), (0.10, 0.22, 0.35)),
    Box((70.0, -30.0, 0.0), (71.0, 30.0, 40.0), (0.75, 0.78, 0.80)),
)


class Bulb(NamedTuple):
    """A small bright sphere: center, radius, radiant intensity over display white (m^2)."""

    center: tuple[float, float, float]
    radius: float
    intensity: float


BULBS = Bulb((14.0, -2.0, 2.5), 0.05, 4.0), Bulb((9.0, 1.6, 0.8), 0.03, 0.5)


def boxes_hit(origins, directions):
    """Linear light (n, 3) and distance (n; 0 for none) of the first box on rays."""
    nearest, light = np.full(len(directions), np.inf), np.zeros((len(directions), 3))
    with np.errstate(divide="ignore"):
        inverse = 1 / np.where(directions == 0, 1e-30, directions)
    for box in BOXES:
        first, last = (np.array(box.low) - origins) * inverse, (np.array(box.high) - origins) * inverse
        enter, leave = np.minimum(first, last).max(axis=1), np.maximum(first, last).min(axis=1)
        hit = (enter < leave) & (enter > 1e-6) & (enter < nearest)
        nearest[hit], light[hit] = enter[hit], box.light
    return light, np.where(np.isfinite(nearest), nearest, 0.0)
