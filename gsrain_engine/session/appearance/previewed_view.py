"""One view as a transfer makes it, and what it is of: it is shown only where it fits."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from gsrain_engine.appearance.transfer_settings import TransferSettings
from gsrain_engine.scene.camera import Camera
from gsrain_engine.scene.scene import Scene

_SAME = 1e-4
"""Of a pose's numbers and of a field of view."""
_SAME_SHAPE = 0.01
"""Of a picture's proportions: a viewport has whole pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class Recipe:
    """A method and its settings."""

    method: str
    settings: TransferSettings


@dataclass(frozen=True, slots=True, eq=False)
class PreviewedView:
    """A picture, soaked, and the view that it is of."""

    pixels: UInt8[np.ndarray, "h w 3"]
    """Display colour."""
    camera: Camera
    """In the world, of the viewport's size when it was asked for."""
    time_s: float
    scene: Scene
    recipe: Recipe

    def is_of(self, camera: Camera, time_s: float, scene: Scene) -> bool:
        own = self.camera
        return (
            np.allclose(own.world_to_camera, camera.world_to_camera, atol=_SAME)
            and abs(own.height / own.fy - camera.height / camera.fy) < _SAME
            and abs(own.width / own.height - camera.width / camera.height) < _SAME_SHAPE
            and (not scene.actors or abs(self.time_s - time_s) < _SAME)
            and _looks_alike(self.scene, scene)
        )

    def is_made_by(self, recipe: Recipe) -> bool:
        """Whether the method and its settings are those that it was made with."""
        return (self.recipe.method, self.recipe.settings) == (recipe.method, recipe.settings)


def _looks_alike(one: Scene, other: Scene) -> bool:
    """Whether two scenes look the same while they are dry."""
    return one is other or _dry(one).matter == _dry(other).matter


def _dry(scene: Scene) -> Scene:
    for member in scene.members:
        if member.wet_sh is not None:
            scene = scene.with_member(member.key, wet_sh=None)
    return scene
