"""Gaps low over the horizon of a mirror's picture: what was hidden there is no sky."""

from dataclasses import replace

import numpy as np

from ..clear_view import ClearView
from ..normals.from_depth import view_rays
from .ground_plane import GroundPlane

_LOW = 0.06
"""Rise of rays (3.4 degrees) up to which something of the world is always in the way."""


def without_gaps(view: ClearView, plane: GroundPlane) -> ClearView:
    """Let what stands over a gap near the horizon reach down to it, under cars or where the captured world ends.

    Where there is nothing at all there is sky.
    """
    rays = view_rays(view.camera)
    rise = (rays @ plane.normal) / np.linalg.norm(rays, axis=-1)
    gap = (view.depth <= 0) & (rise < _LOW)
    rows = np.arange(gap.shape[0])[:, None]
    above = np.maximum.accumulate(np.where(gap, -1, np.where(view.depth > 0, rows, -1)), axis=0)
    filled = gap & (above >= 0)
    source, columns = np.where(filled, above, rows), np.arange(gap.shape[1])[None]
    taken = {name: getattr(view, name)[source, columns] for name in ("image", "depth", "normals", "sky", "vehicles")}
    taken["sky"] = np.where(taken["depth"] > 0, taken["sky"], np.float32(1))
    return replace(view, **taken)
