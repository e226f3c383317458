"""A scene on its way into the picture, and how it comes into the document."""

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gsrain_engine.scene.scene import Scene
from gsrain_engine.scene.wet_colors import with_wet_colors_of

from .edits.new_gaussians import with_gaussians_of

if TYPE_CHECKING:
    from .session import Session

logger = logging.getLogger("gsrain")


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

    def arrive(self, session: "Session") -> None:
        """Come into the document of a session."""
        is_present = session.history.gesture == self.gesture
        if self.is_opened:
            session.enter(session.files.arrive(self.scene))
            logger.info("Opened %s: %s Gaussians", self.label, f"{self.scene.gaussian_count:,}")
        elif self.goes_on and not is_present:
            return  # a person has gone on with something else
        elif self.is_whole:
            session.set_scene(self.label, self.scene, self.gesture)
            if self.gesture is None or not is_present:
                session.enter_scene()
        elif self.only_wet_colors:
            before = session.scene
            session.edit(self.label, with_wet_colors_of, self.scene, gesture=self.gesture)
            if session.scene is not before:
                logger.info("Wet colours are there: they come with the rain's intensity, or with the Wetness by hand")
        else:
            session.set_scene(self.label, with_gaussians_of(session.scene, self.scene), self.gesture)
