"""Sky color of a scene, which its drops (paper, eq. 3) and its rain and fog have: sampled once for all cameras."""

from collections.abc import Generator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from ..rain.frame import SkyLight
from ..rain.simulation import OVERCAST, mean_linear_color
from ..scene.camera import Camera, look_at
from ..scene.scene import Scene
from .level_of_detail import Thinning, subset_items
from .renderer import Renderer

_VIEWS, _WIDTH, _HEIGHT, _FOV_DEG = 4, 160, 120, 75.0
_FAR_M = 60.0  # minimum distance of sky above the horizon, in scenes without a sky layer
_MIN_PIXELS = 200
_HORIZON_DEG = 4.0  # of the visible sky just above its lower edge are airlight
_LOWEST_PIXELS = 20  # may lie below that edge, such as in gaps between houses


class SkyColor(NamedTuple):
    """Colors of drops and medium from the sky; `found` is false for the default color."""

    light: SkyLight
    """Light in the dry scene, as it is lit."""
    found: bool
    wet_light: SkyLight | None = None
    """Light in the soaked scene, whose sky is overcast; None if it is the same."""

    def at(self, overcast: float) -> SkyLight:
        """Light at a share of the overcast sky (0..1): a linear mix in display values, as for each Gaussian."""
        return self.light if self.wet_light is None else self.light.mixed(self.wet_light, overcast)


def sky_color(
    renderer: Renderer,
    scene: Scene,
    place: Camera,
    time_s: float = 0.0,
    thinning: Thinning | None = None,
    *,
    dry: bool = False,
) -> SkyColor:
    """Render around a camera's position and average the sky in linear light.

    Sky is the visible part of a sky layer, or where something hides it all around, its part above the horizon; in a
    scene without one, distant pixels above the horizon. If there is neither, drops have the color of an overcast sky.
    Airlight is the mean of the lowest degrees of a sky layer; without one it has the color of drops.
    """
    steps = sample_sky(renderer, scene, place, time_s, thinning, dry=dry)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def sample_sky(
    renderer: Renderer,
    scene: Scene,
    place: Camera,
    time_s: float = 0.0,
    thinning: Thinning | None = None,
    *,
    dry: bool = False,
) -> Generator[None, None, SkyColor]:
    """Compute `sky_color` in steps of one image, so that frames can be drawn in between; returns the sky.

    `thinning` leaves out some Gaussians, for a quick first answer. A scene with wet colors is sampled twice, unless it
    stays `dry`.
    """
    clear = yield from _visible_sky(renderer, scene, place, time_s, thinning, wetness=0.0)
    if clear is None or not scene.has_wet_colors or dry:
        return SkyColor(clear or OVERCAST, clear is not None)
    return SkyColor(clear, True, (yield from _visible_sky(renderer, scene, place, time_s, thinning, wetness=1.0)))


def _visible_sky(
    renderer: Renderer, scene: Scene, place: Camera, time_s: float, thinning: Thinning | None, *, wetness: float
) -> Generator[None, None, SkyLight | None]:
    """Light of the sky around a position, also of one that something hides there; None if there is hardly any."""
    layers = tuple(layer for layer in scene.layers if layer.kind == "sky" and layer.visible)
    colors, rises = yield from _sky_pixels(renderer, scene, place, time_s, thinning, wetness)
    if layers and len(colors) < _MIN_PIXELS:  # inside of a truck or a house
        alone = replace(scene, layers=layers, actors=())
        colors, rises = yield from _sky_pixels(renderer, alone, place, time_s, thinning, wetness)
        colors, rises = colors[rises >= 0], rises[rises >= 0]
    if len(colors) < _MIN_PIXELS:
        return None
    lowest = max(np.partition(rises, _LOWEST_PIXELS)[_LOWEST_PIXELS], 0.0)  # without ground, a sky goes on below
    low = colors[(rises >= 0) & (rises <= lowest + np.sin(np.radians(_HORIZON_DEG)))]
    return SkyLight(mean_linear_color(colors), mean_linear_color(low if layers and len(low) else colors))


def _sky_pixels(
    renderer: Renderer, scene: Scene, place: Camera, time_s: float, thinning: Thinning | None, wetness: float
) -> Generator[None, None, tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, " n"]]]:
    """Display colors of the sky in views around a position, and the sines of their elevations."""
    found: list[np.ndarray] = []
    sines: list[np.ndarray] = []
    has_sky = any(layer.kind == "sky" and layer.visible for layer in scene.layers)
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
        if has_sky:
            renderer.draw(subset_items(without_sky.parts(time_s), thinning, camera), camera)
            mask = (renderer.read().rgba[..., 3] < 0.05) & (alpha > 0.5)
            yield
        else:  # above points straight ahead at the camera's own height, and five degrees more
            horizon_row = float(camera.cy + camera.fy * np.tan(np.radians(15.0)))
            mask = (alpha > 0.5) & (frame.depth > _FAR_M) & (np.arange(_HEIGHT)[:, None] < horizon_row)
        found.append(frame.rgba[mask][:, :3] / alpha[mask][:, None])
        sines.append(_rise(camera)[mask])
    return np.clip(np.concatenate(found).astype(np.float64), 0, 1), np.concatenate(sines)


def _rise(camera: Camera) -> Float64[np.ndarray, "h w"]:
    """Sine of the elevation of each pixel's ray above the horizon."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5 - camera.cx, np.arange(camera.height) + 0.5 - camera.cy)
    rays = np.stack([x / camera.fx, y / camera.fy, np.ones_like(x)], axis=-1)
    return rays @ camera.world_to_camera[:3, 2] / np.linalg.norm(rays, axis=-1)
