"""The job "Reconstruct": a capture becomes Gaussians in another process, and can be watched in the view meanwhile."""

from collections.abc import Iterator
from pathlib import Path

from gsrain_engine.reconstruct.training.settings import TrainingSettings
from gsrain_engine.reconstruct.training.task import ReconstructionTask
from gsrain_engine.scene.errors import SceneFormatError
from gsrain_engine.scene.formats import read_scene
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from ..document.staged_scene import StagedScene
from .report_files import new_report
from .scene_job import Assignment
from .torch_extra import require_torch

_SCENE, _SNAPSHOT = "scene", "snapshot"


class Reconstruction:
    """One capture to be reconstructed, a `SceneTask`."""

    preparing = "Starting"

    def __init__(self, capture: Path, settings: TrainingSettings, *, allow_outside: bool = False) -> None:
        self.title = f"Reconstruct {capture.name}"
        self.report: Path | None = new_report(capture.name)
        self._capture, self._settings, self._allow_outside = capture, settings, allow_outside
        self._seen_ns = 0

    def prepare(self, folder: Path) -> Assignment:
        task = ReconstructionTask(
            capture=self._capture, output=folder / _SCENE, settings=self._settings, report=self.report,
            snapshot=folder / _SNAPSHOT, allow_outside=self._allow_outside,
        )  # fmt: skip
        return Assignment(reconstruct_capture, (task,))

    def snapshot(self, folder: Path) -> Scene | None:
        try:
            written_ns = (folder / _SNAPSHOT / "scene.json").stat().st_mtime_ns
            if written_ns == self._seen_ns:
                return None
            scene = read_scene(folder / _SNAPSHOT)
        except (OSError, SceneFormatError):
            return None  # not there yet, or just being replaced: there will be another
        self._seen_ns = written_ns
        return scene

    def load(self, folder: Path) -> Scene:
        return read_scene(folder / _SCENE)

    def staged(self, scene: Scene) -> StagedScene:
        """Take the place of the present scene, as a step that can be undone."""
        return StagedScene(self.title, scene, is_whole=True)


def reconstruct_capture(task: ReconstructionTask) -> Iterator[Progress]:
    """Work of the job, for a process that has torch."""
    require_torch("reconstructing")
    from gsrain_engine.reconstruct.training.training import reconstruct

    yield from reconstruct(task)
