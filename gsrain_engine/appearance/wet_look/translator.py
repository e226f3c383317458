"""The transfer `wet`: a view on a day of rain, without any weights."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float32

from ...scene.geometry import linear_to_srgb, srgb_to_linear
from ..base import ClearView, RainyView
from ..normals import view_rays
from .environment import Surroundings
from .illumination import (
    SceneLight,
    before_cloud,
    daylight,
    like_own_sky,
    overcast_picture,
    overcast_surfaces,
    scene_light,
    with_own_sky,
)
from .masks import Ground, surfaces_of
from .materials import in_mist, lamp_share, wetted, with_gloss, with_lamps
from .settings import WetSettings
from .water import water_on

Image = Float32[np.ndarray, "h w 3"]

LIGHT_AND_SKY = "only light, colors and the sky where it is sure: their depth is not known, so nothing is made wet"
"""What is left out of pictures alone."""


class WetTransfer:
    """Overcast light, wet materials, water, lamps and mist; the same view by view, since all is told by the scene."""

    def __init__(self, settings: WetSettings, surroundings: Surroundings, light: SceneLight | None = None) -> None:
        self._settings, self._surroundings, self._light = settings, surroundings, light

    @property
    def name(self) -> str:
        return "wet"

    def light_of(self, views: Sequence[ClearView]) -> SceneLight:
        """The light that views were seen in: what was given, or what they tell."""
        return scene_light(views) if self._light is None else self._light

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        """Make views rainy in their order. The light is told from some of them first, unless it was given."""
        light = self.light_of(views)
        for i in range(len(views)):
            yield self._rainy(views[i], light)

    def _rainy(self, view: ClearView, light: SceneLight) -> RainyView:
        settings = self._settings
        if settings.wetness == 0:
            return RainyView(view, view.image, np.zeros_like(view.sky))

        if not view.has_surfaces:
            dull = np.clip(linear_to_srgb(rainy_picture(view, settings)), 0, 1).astype(np.float32)
            return RainyView(view, dull, np.zeros_like(view.sky), LIGHT_AND_SKY)

        def look(each: ClearView) -> Image:
            return rainy_light(each, light, settings, self._surroundings.ground(each))

        shown, film = look(view), np.zeros_like(view.sky)
        water = water_on(view, shown, self._surroundings, look, settings.wetness, settings.seed)
        if water is not None:
            left = ((1 - water.share) * water.through)[..., None]
            shown, film = left * shown + water.color, water.share
        return RainyView(view, np.clip(linear_to_srgb(shown), 0, 1).astype(np.float32), film)


def rainy_picture(view: ClearView, settings: WetSettings) -> Image:
    """Return a view of which no surfaces are known on a rainy day, linear light: its light, its colours and its sky.

    Nothing is wet in it: a film or a puddle might lie on a vehicle or on a person.
    """
    clear = srgb_to_linear(view.image).astype(np.float32)
    view = with_own_sky(view)
    rainy = before_cloud(view, overcast_picture(view, settings), like_own_sky(view, settings, daylight(view)))
    return ((1 - settings.wetness) * clear + settings.wetness * rainy).astype(np.float32)


def rainy_light(view: ClearView, light: SceneLight, settings: WetSettings, ground: Ground | None) -> Image:
    """Return the view on a rainy day but for the water on the ground, linear light."""
    clear = srgb_to_linear(view.image).astype(np.float32)
    view = with_own_sky(view)
    rays = view_rays(view.camera)
    directions = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    surfaces = surfaces_of(view, ground)
    surface = wetted(overcast_surfaces(view, light, settings, surfaces), surfaces, settings)
    surface = with_gloss(surface, surfaces, directions, settings)
    surface = with_lamps(surface, view, lamp_share(view, surfaces, settings.tail_lamps), settings.lamps)
    rainy = before_cloud(view, in_mist(surface, view, rays, settings), settings)
    return ((1 - settings.wetness) * clear + settings.wetness * rainy).astype(np.float32)
