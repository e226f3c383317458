"""The job "Make it rainy": views are transferred, and wet colours solved for that look like them."""

from pathlib import Path

from gsrain_engine.reconstruct.recoloring.recolored_file import read_recolored
from gsrain_engine.reconstruct.recoloring.recolored_scene import with_colors
from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.scene import Scene

from ..document.staged_scene import StagedScene
from ..jobs.report_files import new_report
from ..jobs.scene_copy import write_copy
from ..jobs.scene_job import Assignment
from .transfer_work import TransferOrder, make_rainy

TITLE = "Make it rainy"
_COLORS = "colors.npz"


class RainyScene:
    """One scene to be made rainy, a `SceneTask`."""

    title = TITLE
    preparing = "Saving the scene for the worker"

    def __init__(self, scene: Scene, known: KnownFiles, order: TransferOrder) -> None:
        self.report: Path | None = new_report(f"{scene.name} made rainy")
        self._scene, self._known, self._order = scene, known, order

    def prepare(self, folder: Path) -> Assignment:
        copy = write_copy(self._scene, folder, self._known)
        return Assignment(make_rainy, (copy, self._order, folder / _COLORS, self.report))

    def snapshot(self, folder: Path) -> Scene | None:
        """Show nothing in the view before the end: the panel shows each picture."""
        return None

    def load(self, folder: Path) -> Scene:
        return with_colors(self._scene, read_recolored(folder / _COLORS))

    def staged(self, scene: Scene) -> StagedScene:
        """Bring the wet colours, and nothing else."""
        return StagedScene(TITLE, scene, only_wet_colors=True)
