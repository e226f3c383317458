"""Gaussians as one camera sees them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, Int64

SCENE_ALPHA_CUT = 1 / 255
"""Fainter fragments of the scene are left out, as in the reference rasterizer."""

RAIN_ALPHA_CUT = 1 / 65536
"""The same for rain: a streak's alpha is about 0.01, of which 1/255 would leave nothing."""

LOG_SCENE_CUT, LOG_RAIN_CUT = float(np.log(SCENE_ALPHA_CUT)), float(np.log(RAIN_ALPHA_CUT))
"""What stands in `Splats.shapes`; it tells rain from scene."""

LEAST_SCENE_CUT = np.float32(LOG_SCENE_CUT - 1)
"""Rain's logarithm is below, the scene's above."""


@dataclass(frozen=True, slots=True, eq=False)
class Splats:
    """Gaussians that one camera may see, in their own order.

    A row of `shapes` holds x, y, shear, sharpness_x, sharpness_y, log_opacity, log_cut, reach_x. With the pixel centre
    (u, v) and dx = u - x,

        ln alpha = log_opacity + sharpness_x * dx^2 + sharpness_y * (v - y - shear * dx)^2, cut below log_cut,

    where shear = cov_xy / cov_xx, sharpness_x = -1 / (2 cov_xx), sharpness_y = -cov_xx / (2 det), |dx| <= reach_x: the
    2D Gaussian column by column, both terms negative, so that no cancellation spoils long needles. By columns because
    rain falls: a streak touches few of them.
    """

    shapes: Float32[np.ndarray, "m 8"]
    colors: Float32[np.ndarray, "m 4"]
    """Display colour, never negative, and depth along the view axis in metres.

    All 0 for the few that turn out not to be seen: those are not drawn."""
    indices: Int64[np.ndarray, " m"]
    """Which Gaussian it is, counted through all parts in order, rising; those beyond a part's limit count too."""

    def __len__(self) -> int:
        return len(self.indices)

    @property
    def is_rain(self) -> Bool[np.ndarray, " m"]:
        return self.shapes[:, 6] < LEAST_SCENE_CUT

    def nearest_first(self) -> Int32[np.ndarray, " drawn"]:
        """Rows that are drawn, sorted by depth; equal depths keep their index."""
        return nearest_first(self.colors[:, 3])


def nearest_first(depths: Float[np.ndarray, " m"]) -> Int32[np.ndarray, " drawn"]:
    """Rows with a depth above 0, sorted by it as float32; equal depths keep their index.

    One 64-bit number each, depth above row: no two are equal, so any fast sort is a stable one. The bits of a positive
    float32 sort like the number itself.
    """
    depths = np.ascontiguousarray(depths, np.float32)
    rows = np.flatnonzero(depths)
    keys = depths[rows].view(np.uint32).astype(np.uint64)
    keys <<= np.uint64(32)
    keys |= rows.astype(np.uint64)
    keys.sort()
    return keys.astype(np.uint32).view(np.int32)  # the lower halves
