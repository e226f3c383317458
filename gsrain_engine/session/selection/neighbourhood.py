"""Selections that grow into what is near them, or shrink away from it."""

import numpy as np
import scipy
from jaxtyping import Bool, Float64

from gsrain_engine.scene.mask import Mask
from gsrain_engine.scene.scene import Scene

from .candidates import candidates, shown
from .combine import selected
from .world_points import by_member, world_points


def grown(scene: Scene, time_s: float, distance_m: float) -> dict[str, Mask]:
    """Find what is not selected and whose centre is at most so far from a selected one's."""
    return _near(scene, time_s, distance_m, of_selected=True)


def rim(scene: Scene, time_s: float, distance_m: float) -> dict[str, Mask]:
    """Find what is selected and at most so far from what is shown and not: without it a selection has shrunk."""
    return _near(scene, time_s, distance_m, of_selected=False)


def _near(scene: Scene, time_s: float, distance_m: float, *, of_selected: bool) -> dict[str, Mask]:
    own = candidates(scene, time_s)
    members = [scene.member(each.key) for each in own]
    inside = {each.key: selected(each) & shown(each) for each in members}
    outside = {each.key: shown(each) - selected(each) for each in members}
    sources, targets = (inside, outside) if of_selected else (outside, inside)
    points, owners = world_points(own, targets)
    return by_member(own, owners[_reached(points, world_points(own, sources)[0], distance_m)])


def _reached(
    points: Float64[np.ndarray, "m 3"], sources: Float64[np.ndarray, "k 3"], distance_m: float
) -> Bool[np.ndarray, " m"]:
    flags = np.zeros(len(points), np.bool_)
    if not len(sources) or not len(points):
        return flags
    low, high = sources.min(axis=0) - distance_m, sources.max(axis=0) + distance_m
    rows = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    if not len(rows):
        return flags
    low, high = points[rows].min(axis=0) - distance_m, points[rows].max(axis=0) + distance_m
    near = sources[((sources >= low) & (sources <= high)).all(axis=1)]
    if len(near):
        # Where a distance is beyond the bound it comes back as infinite.
        tree = scipy.spatial.KDTree(near, balanced_tree=False, compact_nodes=False)
        found, _ = tree.query(points[rows], distance_upper_bound=np.nextafter(distance_m, np.inf), workers=-1)
        flags[rows] = found <= distance_m
    return flags
