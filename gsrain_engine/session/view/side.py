"""One side of the viewport: the only one, or one of two that are compared."""

from typing import NamedTuple

from gsrain_engine.rain.rainfall import Rainfall
from gsrain_engine.scene.scene import Scene


class Side(NamedTuple):
    """What one side of the viewport shows."""

    label: str
    scene: Scene
    rainfall: Rainfall
