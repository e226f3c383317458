"""The job "Make it rainy (preview)": the scene gets wet colours from views with a plain wet look."""

from pathlib import Path
from typing import TYPE_CHECKING

from gsrain_engine.reconstruct.recoloring.recolored_file import read_recolored
from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.scene import Scene

from ..staged_scene import StagedScene
from .rainy_look import make_rainy, with_colors
from .scene_copy import write_copy
from .scene_job import Assignment

if TYPE_CHECKING:
    from ..session import Session

TITLE = "Make it rainy (preview)"
_COLORS = "colors.npz"


class RainyLook:
    """One scene to be made rainy, a `SceneTask`."""

    title = TITLE
    preparing = "Saving the scene for the worker"
    report = None

    def __init__(self, scene: Scene, known: KnownFiles) -> None:
        self._scene, self._known = scene, known

    def prepare(self, folder: Path) -> Assignment:
        """Write the scene for the worker."""
        return Assignment(make_rainy, (write_copy(self._scene, folder, self._known), folder / _COLORS))

    def snapshot(self, folder: Path) -> Scene | None:
        """Show nothing before the end."""
        return None

    def load(self, folder: Path) -> Scene:
        """Read the wet colours."""
        return with_colors(self._scene, read_recolored(folder / _COLORS))

    def staged(self, scene: Scene) -> StagedScene:
        """Bring the wet colours, and nothing else."""
        return StagedScene(TITLE, scene, only_wet_colors=True)


def make_rainy_look(session: "Session") -> None:
    """Start the job for a session's scene; one at a time."""
    if not any(job.title == TITLE for job in session.running_jobs):
        session.start_task(RainyLook(session.scene, session.files.known))
