"""Map of the water on the street: films and puddles between the house fronts."""

import numpy as np

from gsrain_engine.scene.ground_water import GroundWater

from .layout import StreetLayout
from .wet_surfaces import water_shares

_CELL_M = 0.2
_BEYOND_M = 13.0  # of the cross streets, beyond the rows of houses


def street_water(layout: StreetLayout) -> GroundWater:
    """Shares of the road and the sidewalks that films and standing water cover when fully wet."""
    p = layout.parameters
    corner = p.start_x_m - _BEYOND_M, -p.front_y_m
    x = np.arange(corner[0], p.end_x_m + _BEYOND_M, _CELL_M) + _CELL_M / 2
    y = np.arange(corner[1], p.front_y_m, _CELL_M) + _CELL_M / 2
    points = np.zeros((len(y), len(x), 3))
    points[..., 0], points[..., 1] = x, y[:, None]
    points = points.reshape(-1, 3)
    shares = np.stack(water_shares(layout, points), axis=1)
    cover = np.rint(255 * shares).astype(np.uint8).reshape(len(y), len(x), 2)
    return GroundWater(corner, _CELL_M, cover)
