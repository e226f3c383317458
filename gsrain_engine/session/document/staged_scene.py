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
    is_whole: bool = False
    """Whether it is another scene; else it brings new Gaussians for members of the present one."""
    only_wet_colors: bool = False
    """Whether nothing but its wet colours is wanted: what a person has edited meanwhile stays."""
    gesture: str | None = None
    """Scenes of one gesture make one step: snapshots of a training, and what it ends with."""
    goes_on: bool = False
    """Whether it is only wanted while the step of its gesture is the present one."""
