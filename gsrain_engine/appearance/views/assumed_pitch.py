"""How far a camera of unknown pose is tilted: its road ends below the horizon."""

from dataclasses import replace

import numpy as np

from gsrain_engine.datasets.capture import View
from gsrain_engine.scene.camera import Camera

from .road_pixels import road_pixels

_HIGHEST = 0.3
"""Part of the picture's height above which no horizon is looked for."""
_LEAST_WIDTH = 0.02
"""Of a row of road, over the picture's width, that tells that the road reaches so far."""


def levelled(view: View) -> View:
    """Tilt a view that looks level so that the horizon is where its road ends, if that is above the picture's middle.

    The road may end at a car sooner than at the horizon: a lower end tells nothing.
    """
    camera = view.camera
    rows = np.arange(camera.height)[:, None]
    may_be = np.broadcast_to(rows > _HIGHEST * camera.height, (camera.height, camera.width))
    sky = view.sky
    road = road_pixels(view.image, may_be if sky is None else may_be & ~sky)
    long_rows = np.flatnonzero(road.sum(axis=1) >= _LEAST_WIDTH * camera.width)
    if not len(long_rows) or long_rows[0] >= camera.cy:
        return view
    return replace(view, camera=_tilted_down(camera, (camera.cy - long_rows[0]) / camera.fy))


def _tilted_down(camera: Camera, tangent: float) -> Camera:
    """Turn a camera about its own x axis, so that it looks down by an angle of that tangent."""
    length = np.hypot(1, tangent)
    cosine, sine = 1 / length, tangent / length
    turn = np.eye(4)
    turn[1:3, 1:3] = [[cosine, -sine], [sine, cosine]]
    return replace(camera, world_to_camera=turn @ camera.world_to_camera)
