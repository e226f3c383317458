"""Transfer `wet`: makes views rainy from light, depth and normals, without weights."""

from collections.abc import Iterator, Sequence

import numpy as np

from ...scene.geometry import linear_to_srgb, srgb_to_linear
from ..base import ClearView, Image, RainyView
from ..normals import view_directions, view_rays
from . import illumination
from .environment import ReflectionEnvironment
from .illumination import IlluminationEstimate, composite_over_cloud, estimate_illumination, extend_sky_mask
from .masks import VisibleGround, surfaces_of
from .materials import add_clear_coat, add_emissive_lights, apply_fog, emissive_share, wet_surfaces_color
from .settings import WetSettings
from .water import water_layer_of

LIGHT_AND_SKY = "only light, colors and the sky where it is sure: their depth is not known, so nothing is made wet"
"""Skipped steps of views without surfaces."""


class WetTransfer:
    """Overcast light, wet materials, water, lamps and mist; consistent across views, since all come from the scene."""

    name = "wet"

    def __init__(self, settings: WetSettings, surroundings: ReflectionEnvironment) -> None:
        self._settings, self._surroundings = settings, surroundings

    def transferred(self, views: Sequence[ClearView]) -> Iterator[RainyView]:
        """Yield rainy views in order; light is first estimated from some of the views."""
        light = estimate_illumination(views)
        for i in range(len(views)):
            yield self._rainy(views[i], light)

    def _rainy(self, view: ClearView, light: IlluminationEstimate) -> RainyView:
        settings = self._settings
        if settings.wetness == 0:
            return RainyView(view, view.image, np.zeros_like(view.sky))

        def look(each: ClearView) -> Image:
            return rainy_light(each, light, settings, self._surroundings.ground(each))

        has_surfaces = view.has_surfaces
        rainy, film = look(view) if has_surfaces else rainy_image(view, settings), np.zeros_like(view.sky)
        if has_surfaces:
            water = water_layer_of(view, rainy, self._surroundings, look, settings.wetness, settings.seed)
            if water is not None:
                remaining = ((1 - water.share) * water.through)[..., None]
                rainy, film = remaining * rainy + water.color, water.share
        left_out = "" if has_surfaces else LIGHT_AND_SKY
        displayed = np.clip(linear_to_srgb(rainy), 0, 1).astype(np.float32)
        return RainyView(view, displayed, film, left_out)


def rainy_image(view: ClearView, settings: WetSettings) -> Image:
    """Return a view without known surfaces on a rainy day, in linear light: its light, colors and sky.

    No surface becomes wet: a film or a puddle might lie on a vehicle or a person.
    """
    clear = srgb_to_linear(view.image).astype(np.float32)
    view = extend_sky_mask(view)
    cloud = illumination.match_sky_brightness(view, settings, illumination.daylight(view))
    rainy = composite_over_cloud(view, illumination.overcast_image(view, settings), cloud)
    return ((1 - settings.wetness) * clear + settings.wetness * rainy).astype(np.float32)


def rainy_light(
    view: ClearView, light: IlluminationEstimate, settings: WetSettings, ground: VisibleGround | None
) -> Image:
    """Return the view on a rainy day without the water on the ground, in linear light."""
    clear = srgb_to_linear(view.image).astype(np.float32)
    view = extend_sky_mask(view)
    surfaces = surfaces_of(view, ground)
    surface = illumination.overcast_surfaces(view, light, settings, surfaces)
    surface = wet_surfaces_color(surface, surfaces, settings)
    surface = add_clear_coat(surface, surfaces, view_directions(view.camera), settings)
    surface = add_emissive_lights(surface, view, emissive_share(view, surfaces, settings.tail_lamps), settings.lamps)
    rainy = composite_over_cloud(view, apply_fog(surface, view, view_rays(view.camera), settings), settings)
    return ((1 - settings.wetness) * clear + settings.wetness * rainy).astype(np.float32)
