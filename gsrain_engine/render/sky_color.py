"""Sky color of a scene, used as the color of its drops (paper, eq. 3): sampled once for all cameras."""

from collections.abc import Generator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..rain.simulation import OVERCAST, mean_linear_color
from ..scene.camera import Camera, look_at
from ..scene.scene import Scene
from .draw import Thinning, subset_items
from .renderer import Color, Renderer

_VIEWS, _WIDTH, _HEIGHT, _FOV_DEG = 4, 160, 120, 75.0
_FAR_M = 60.0  # minimum distance of sky above the horizon, in scenes without a sky layer
_MIN_PIXELS = 200


class SkyColor(NamedTuple):
    """Mean color of the sky; `found` is false for the default color."""

    color: Color
    """Color in the dry scene, as it is lit."""
    found: bool
    wet_color: Color | None = None
    """Color in the soaked scene, whose sky is overcast; None if it is the same."""

    def at(self, overcast: float) -> Color:
        """Color at a share of the overcast sky (0..1): a linear mix in display values, as for each Gaussian."""
        if self.wet_color is None:
            return self.color
        red, green, blue = ((1 - overcast) * c + overcast * w for c, w in zip(self.color, self.wet_color, strict=True))
        return red, green, blue


def sky_color(
    renderer: Renderer, scene: Scene, place: Camera, time_s: float = 0.0, thinning: Thinning | None = None
) -> SkyColor:
    """Render around a camera's position and average the sky in linear light.

    Sky is the visible part of a sky layer; in a scene without one, distant pixels above the horizon. If there is
    neither, drops have the color of an overcast sky.
    """
    steps = sample_sky(renderer, scene, place, time_s, thinning)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def sample_sky(
    renderer: Renderer, scene: Scene, place: Camera, time_s: float = 0.0, thinning: Thinning | None = None
) -> Generator[None, None, SkyColor]:
    """Compute `sky_color` in steps of one image, so that frames can be drawn in between; returns the sky.

    `thinning` leaves out some Gaussians, for a quick first answer. A scene with wet colors is sampled twice.
    """
    clear = yield from _mean_visible_sky(renderer, scene, place, time_s, thinning, wetness=0.0)
    if clear is None or not scene.has_wet_colors:
        return SkyColor(clear or OVERCAST, clear is not None)
    return SkyColor(clear, True, (yield from _mean_visible_sky(renderer, scene, place, time_s, thinning, wetness=1.0)))


def _mean_visible_sky(
    renderer: Renderer, scene: Scene, place: Camera, time_s: float, thinning: Thinning | None, *, wetness: float
) -> Generator[None, None, Color | None]:
    """Mean color of the sky around a position; None if hardly any is visible."""
    found: list[np.ndarray] = []
    sky = [layer for layer in scene.layers if layer.kind == "sky" and layer.visible]
    without_sky = replace(scene, layers=tuple(layer for layer in scene.layers if layer.kind != "sky"))
    forward = place.world_to_camera[2, :3]
    heading = float(np.arctan2(forward[1], forward[0]))
    for k in range(_VIEWS):  # tilted up by 20 degrees
        angle = heading + 2 * np.pi * k / _VIEWS
        target = place.position + [np.cos(angle), np.sin(angle), np.tan(np.radians(20.0))]
        pose = look_at(place.position, target, np.array([0.0, 0.0, 1.0]))
        camera = Camera.from_fov(_WIDTH, _HEIGHT, _FOV_DEG, pose)
        renderer.draw(subset_items(scene.parts(time_s, wetness=wetness), thinning, camera), camera, with_depth=True)
        frame = renderer.read()
        assert frame.depth is not None
        alpha = frame.rgba[..., 3]
        yield
        if sky:
            renderer.draw(subset_items(without_sky.parts(time_s), thinning, camera), camera)
            mask = (renderer.read().rgba[..., 3] < 0.05) & (alpha > 0.5)
            yield
        else:  # above points straight ahead at the camera's own height, and five degrees more
            horizon_row = float(camera.cy + camera.fy * np.tan(np.radians(15.0)))
            mask = (alpha > 0.5) & (frame.depth > _FAR_M) & (np.arange(_HEIGHT)[:, None] < horizon_row)
        found.append(frame.rgba[mask][:, :3] / alpha[mask][:, None])
    colors = np.concatenate(found).astype(np.float64)
    return mean_linear_color(np.clip(colors, 0, 1)) if len(colors) >= _MIN_PIXELS else None
