"""How a scene that was on its way comes into the document."""

import logging

from gsrain_engine.scene.wet_colors import with_wet_colors_of

from ..edits.new_gaussians import with_gaussians_of
from .staged_scene import StagedScene
from .viewed_document import ViewedDocument

logger = logging.getLogger("gsrain")


def bring_in(document: ViewedDocument, staged: StagedScene) -> None:
    is_present = document.history.gesture == staged.gesture
    if staged.goes_on and not is_present:
        return  # a person has gone on with something else
    if staged.is_whole:
        document.set_scene(staged.label, staged.scene, staged.gesture)
        if staged.gesture is None or not is_present:
            document.enter_scene()
    elif staged.only_wet_colors:
        before = document.scene
        document.edit(staged.label, with_wet_colors_of, staged.scene, gesture=staged.gesture)
        if document.scene is not before:
            logger.info("Wet colours are there: they come with the rain's intensity, or with the Wetness by hand")
    else:
        document.set_scene(staged.label, with_gaussians_of(document.scene, staged.scene), staged.gesture)
