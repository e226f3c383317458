"""How much of each Gaussian is seen, through what is before it: what "front-most" goes by."""

import numpy as np
from jaxtyping import Float32

from gsrain_engine.raster.accumulation import accumulate
from gsrain_engine.raster.view_weights import ViewWeights, view_weights
from gsrain_engine.render.scene_view import Shot
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import Scene

from .colorless import colorless

LEAST_SHARE = 0.05
"""Behind one opaque surface a share of 0.05 is left at most; neighbours that overlap on a surface keep more."""

_MOST_PIXELS = 120_000
"""Of the picture in which it is found out: coarser than the screen's, and several times faster."""


def seen_shares(scene: Scene, shot: Shot, box: tuple[int, int, int, int]) -> dict[str, Float32[np.ndarray, " n"]]:
    """Find the share of each Gaussian that is seen in a part of the picture, 0..1, by keys of visible members.

    With its weights w of blending (3DGS, Kerbl et al. 2023) over the pixels, the share is 2 sum w^2 / (opacity sum w):
    with w = T alpha and a T that is the same all over a Gaussian, that is T, what all that is nearer lets through.
    `box`: left, top, right, bottom in pixels, the last two past the end.
    """
    members = [member for member in scene.members if member.visible]
    shown = [(member.key, part) for member in members if (part := scene.part(member, shot.time_s)) is not None]
    weights = view_weights([colorless(part) for _, part in shown], _cut_out(shot.camera, box))
    sums, squared = _weight_sums(weights)
    opacities = np.exp(weights.splats.shapes[:, 5])
    shares = np.zeros(sum(len(part.gaussians) for _, part in shown), np.float32)
    is_seen = sums > 0
    seen = 2 * squared[is_seen] / (opacities[is_seen] * sums[is_seen])
    shares[weights.splats.indices[is_seen]] = np.minimum(seen, 1)
    ends = np.cumsum([len(part.gaussians) for _, part in shown])[:-1]
    return {key: own for (key, _), own in zip(shown, np.split(shares, ends), strict=True)}


def _cut_out(camera: Camera, box: tuple[int, int, int, int]) -> Camera:
    """Camera of a part of the picture, in at most so many pixels."""
    left, top, right, bottom = box
    scale = min(1.0, (_MOST_PIXELS / ((right - left) * (bottom - top))) ** 0.5)
    width, height = max(1, round((right - left) * scale)), max(1, round((bottom - top) * scale))
    across, down = width / (right - left), height / (bottom - top)
    return Camera(
        width,
        height,
        camera.fx * across,
        camera.fy * down,
        (camera.cx - left) * across,
        (camera.cy - top) * down,
        camera.world_to_camera,
        camera.exposure_s,
    )


def _weight_sums(weights: ViewWeights) -> tuple[Float32[np.ndarray, " m"], Float32[np.ndarray, " m"]]:
    """Sum of each splat's weights, and of their squares, in one walk through the picture."""
    ones = np.ones((weights.tiles.height, weights.tiles.width, 3), np.float32)
    gathered = accumulate(weights.splats.shapes, ones, weights.tiles)
    return gathered[:, 0], gathered[:, 3]
