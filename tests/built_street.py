"""The built-in street and a short one, each built once in a test process."""

from functools import cache

from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.street.build import StreetSurfaces, scene_of, street_surfaces
from gsrain_engine.scene.street.layout import StreetParameters

WHOLE = StreetParameters()
SHORT = StreetParameters(length_m=120.0, parked_share=0.3, tree_spacing_m=30.0)
"""A third of the Gaussians."""


@cache
def surfaces_of(parameters: StreetParameters = WHOLE) -> StreetSurfaces:
    return street_surfaces(parameters)


@cache
def street_of(parameters: StreetParameters = WHOLE) -> Scene:
    return scene_of(surfaces_of(parameters))
