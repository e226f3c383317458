"""Rain cut into slabs by depth, for a back end that can't sort it in among the scene."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int64

from .splats import Splats

SLABS = 91
"""They have 92 edges; with colour and depth that makes 96 channels, of which gsplat draws 32 at once."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthSlabs:
    """Splats of rain, nearest first, in slabs of equal weight."""

    shapes: Float32[np.ndarray, "m 8"]
    """As in `Splats`."""
    starts: Int64[np.ndarray, " slabs_and_one"]
    """Where each slab's splats start; the last entry is their number."""
    edges_m: Float32[np.ndarray, " slabs_and_one"]
    """Depths between the slabs, those of the nearest and the farthest splat among them; rising."""


def cut_into_slabs(splats: Splats, slabs: int = SLABS) -> DepthSlabs:
    """Cut at depths between which rain weighs the same: opacity times the area of its ellipse.

    What is drawn in the wrong order, the scene's splats in a slab against the rain in it, is then a small share of all
    rain wherever that lies.
    """
    order = splats.nearest_first()
    shapes, depths = splats.shapes[order], splats.colors[order, 3]
    x, y, opacity = (shapes[:, column].astype(np.float64) for column in (3, 4, 5))
    weights = np.cumsum(np.exp(opacity) / np.sqrt(x * y))
    total = weights[-1] if len(order) else 0.0
    inner = np.searchsorted(weights, total * np.arange(1, slabs) / slabs)
    starts = np.concatenate([[0], inner, [len(order)]]).astype(np.int64)
    edges = depths[np.minimum(starts, len(order) - 1)] if len(order) else np.zeros(slabs + 1, np.float32)
    return DepthSlabs(shapes, starts, edges)
