"""Edits that the window makes in the background, as functions that return when they are done."""

from pathlib import Path
from tempfile import TemporaryDirectory

from ..appearance.base import TransferSettings
from ..appearance.view_choice import ViewChoice
from ..scene.open import load_drawable_scene, load_sorted_scene
from ..scene.progress import run_to_end
from ..scene.scene import Scene
from ..training.settings import TrainingSettings
from .edits.floaters import FloaterRules, search_floaters, select_floaters
from .edits.layers import import_scene


def import_file(scene: Scene, path: str) -> Scene:
    """Add the layers and actors of a scene (file, folder or "street"); the world frames agree, names are unique."""
    return import_scene(scene, load_drawable_scene(path))


def find_floaters(scene: Scene, rules: FloaterRules) -> Scene:
    """Select the Gaussians of background layers that are floaters by any of the rules."""
    return select_floaters(scene, run_to_end(search_floaters(scene, rules)))


def apply_wet_look(
    scene: Scene,
    method: str = "wet",
    settings: TransferSettings | None = None,
    choice: ViewChoice | None = None,
    capture: Path | None = None,
    allow_outside: bool = False,
) -> Scene:
    """Transfer views of the scene, and solve for its wet colors."""
    from .jobs.make_rainy import TransferRequest, rainy_by  # transfers load slowly

    order = TransferRequest(method, settings or TransferSettings(), choice or ViewChoice(), capture, allow_outside)
    return run_to_end(rainy_by(scene, order))


def recolor_to_images(scene: Scene, capture: Path, images: Path | None = None, allow_outside: bool = False) -> Scene:
    """Solve for the wet colors in which the scene looks like the images of a capture, or like those of a folder."""
    from .jobs.training import recolored_to  # torch is optional

    return run_to_end(recolored_to(scene, capture, images, allow_outside)).scene


def reconstruct(scene: Scene, capture: Path, settings: TrainingSettings, allow_outside: bool = False) -> Scene:
    """Replace the scene by Gaussians fitted to a capture."""
    from ..training.data import ReconstructionTask
    from .jobs.training import reconstruct_capture  # torch is optional

    with TemporaryDirectory() as folder:
        output = Path(folder, "scene")
        task = ReconstructionTask(capture=capture, output=output, settings=settings, allow_outside=allow_outside)
        for _ in reconstruct_capture(task):
            pass
        return load_sorted_scene(output)
