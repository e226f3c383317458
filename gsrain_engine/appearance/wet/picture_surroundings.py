"""Where a wet ground finds what it mirrors when there is no scene: in the view's own picture and depth."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float32, Float64

from ..clear_view import ClearView
from ..normals.from_depth import view_rays, world_points
from .ground import Ground, ground_of
from .ground_heights import ground_heights
from .ground_plane import fitted_plane
from .mirrored import Mirrored, mirror_camera
from .seen_again import seen_again
from .smoothstep import smoothstep

_SCALE = 0.5
_LEAST_UP = 0.7
_FARTHEST_M = 60.0
_MOST_POINTS = 60_000
_BAND_M = 0.1
_UPRIGHT = 0.5
"""Cosine between the picture's own down and the world's below which no ground is looked for: pictures are upright, so
that the world's up is wrong, and its ground may be a wall."""
_FADE = 0.25
"""Angle in radians over which what stands at the picture's edge is taken to go on beyond it."""


class PictureSurroundings:
    """The surroundings of pictures with depth: each view mirrors what it shows itself, and beyond that the sky.

    The ground is told by the view's own depth, so dips are left out: other views would tell them differently.
    """

    def __init__(self) -> None:
        self._recent_ground = lru_cache(maxsize=2)(_ground)

    def ground(self, view: ClearView) -> Ground | None:
        return self._recent_ground(view)

    def mirrored(self, view: ClearView, ground: Ground) -> Mirrored:
        """Follow mirrored rays through the view's depth.

        What stands at the edge of the picture goes on for a while where rays leave it, rather than give way to the sky
        at once.
        """
        camera = mirror_camera(view.camera, ground.plane, _SCALE)
        again = seen_again(view, ground, camera)
        size = (camera.height, camera.width)
        sky, nothing = np.ones(size, np.float32), np.zeros(size, np.float32)
        mean = np.broadcast_to(_mean_sky(view), (*size, 3)).copy()
        beyond = ClearView(
            f"{view.name} mirrored", camera, view.time_s, mean, nothing, np.zeros((*size, 3), np.float32), sky,
            nothing, view.sensor,
        )  # fmt: skip
        rays = view_rays(camera)
        rows, columns = (np.clip(again.places[..., k].astype(int), 0, limit - 1) for k, limit in
                         ((1, view.camera.height), (0, view.camera.width)))  # fmt: skip
        lent = np.where(again.left, 1 - view.sky[rows, columns], 0) * _near_edge(rays, view, rows, columns)
        again = again.with_hidden_filled()
        known = np.where(again.found, 1, lent).astype(np.float32)
        depth = np.where(again.found, again.depth, np.where(lent > 0.5, view.depth[rows, columns], 0))
        return Mirrored(beyond, again.places, known, depth.astype(np.float32))


def _ground(view: ClearView) -> Ground | None:
    if view.camera.world_to_camera[1, 2] > -_UPRIGHT:
        return None
    level = (view.normals[..., 2] > _LEAST_UP) & (view.depth > 0) & (view.depth < _FARTHEST_M) & (view.vehicles < 0.5)
    points = world_points(view.depth, view.camera)[level]
    points = points[points[:, 2] < view.camera.position[2]]
    points = points[:: max(1, len(points) // _MOST_POINTS)]
    start = fitted_plane(points, _BAND_M)
    if start is None:
        return None
    found = ground_of(view, ground_heights(points, start), start)
    return None if found is None else found.evened()


def _mean_sky(view: ClearView) -> Float32[np.ndarray, "3"]:
    weights = view.sky[..., None] + np.float32(1e-3)
    return (np.sum(weights * view.image, axis=(0, 1)) / weights.sum()).astype(np.float32)


def _near_edge(
    rays: Float64[np.ndarray, "h w 3"], view: ClearView, rows: np.ndarray, columns: np.ndarray
) -> Float32[np.ndarray, "h w"]:
    """1 where a direction is that of the picture's edge at the given pixel, falling to 0 at `_FADE` from it."""
    at_edge = view_rays(view.camera)[rows, columns]
    cosine = np.sum(rays * at_edge, axis=-1) / (np.linalg.norm(rays, axis=-1) * np.linalg.norm(at_edge, axis=-1))
    return 1 - smoothstep(0.0, _FADE, np.arccos(np.clip(cosine, -1, 1)))
