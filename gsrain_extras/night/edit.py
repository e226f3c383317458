"""The edit `night` of a scene: for the window, `gsrain edit` and `gr.edit`."""

from collections.abc import Generator

from gsrain_engine.editor.scene_edits import SceneEdit
from gsrain_engine.scene.lamp_choice import lamp_choice
from gsrain_engine.scene.lamps import Lamp
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene


def relight(scene: Scene, lamps: tuple[Lamp, ...] | str | None = None) -> Generator[Progress, None, Scene]:
    """Relight a scene that was recorded by day as by night; its geometry stays.

    `lamps` are lamps, or their file or choice, such as "none". None takes the scene's own, else lanterns along a drive,
    else two lamps around an object. Those on vehicles light rain and water, not surfaces.

    Raises ValueError for a scene that is dark already, and a file of lamps that can't be read.
    """
    from .night_gaussians import night_scene  # loads slow parts of scipy

    chosen = lamp_choice(lamps).of(scene) if isinstance(lamps, str) else lamps
    return (yield from night_scene(scene, chosen))


EDIT = SceneEdit(
    "Relight for night",
    "Light a scene that was recorded by day by its lamps or new ones, under a dark sky.",
    relight,
)
