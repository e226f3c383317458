"""A scene on its way into the picture."""

from dataclasses import dataclass

from gsrain_engine.scene.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class StagedScene:
    """A new scene that is shown as soon as its Gaussians are on the GPU."""

    label: str
    scene: Scene
    is_opened: bool = False
    """Whether it takes the place of the present document instead of being a step of it."""
