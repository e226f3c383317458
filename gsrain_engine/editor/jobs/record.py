"""Export job and worker: record a saved scene with its rain, weather and path, as `gsrain render PROJECT` does."""

import logging
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from ...backends import open_renderer
from ...rain.keyframes import keyframes_of, rain_of
from ...rain.settings import RainSettings
from ...rain.simulation import RainSimulation
from ...render.export import export_frames, export_sequences, frame_numbers
from ...render.export_settings import DEFAULT_SIZE_PX, ExportSettings
from ...scene.camera_path import CameraPath
from ...scene.formats.scene_folder import FileCache
from ...scene.open import load_sorted_scene
from ...scene.progress import Progress
from ...scene.scene import Scene
from ..notifications import describe_error
from ..viewport.camera import default_path
from .job import CopiedSceneJob
from .process import WorkerProcess, install_sigterm_handler


def own_path(scene: Scene, width: int, height: int) -> CameraPath:
    """The scene's camera path, else the ego's drive, else an orbit. World frame, meters."""
    return default_path(scene, width, height) if scene.path is None else scene.path.moved(scene.scene_to_world)


def record_project(folder: Path, recording: ExportSettings) -> Iterator[Progress]:
    """Record a scene folder.

    Raises:
        ValueError: For inconsistent settings, such as a camera that the scene lacks.
        OSError: If it can't be written; the part written so far is playable.
    """
    yield Progress(0.0, "Reading the scene")
    scene = load_sorted_scene(str(folder))
    rainfall = RainSimulation.start(rain_of(scene) or RainSettings(), weather=keyframes_of(scene))
    path = own_path(scene, *(recording.size_px or DEFAULT_SIZE_PX))
    sequences = export_sequences(recording, scene, rainfall, path, in_scene_time=scene.path is not None)
    with open_renderer() as renderer:
        yield from export_frames(renderer, recording, sequences, frame_numbers(recording, sequences))


def record_in_worker(folder: Path, recording: ExportSettings) -> Iterator[Progress]:
    """Worker: record a scene folder; on SIGTERM, closes its videos first."""
    install_sigterm_handler()
    yield from record_project(folder, recording)


# Export job

logger = logging.getLogger("gsrain")


class ExportJob(CopiedSceneJob):
    """One recording, with the same settings as the command line."""

    ends_with_scene = False  # it has its own copy of the document

    def __init__(
        self,
        scene: Scene,
        recording: ExportSettings,
        files: ThreadPoolExecutor,
        known: FileCache,
        notes: Sequence[str] = (),
    ) -> None:
        """Start; `notes` are logged at the end."""
        title = f"Record {recording.path.name}"
        super().__init__(
            title, scene, known, files, lambda copy: WorkerProcess(title, record_in_worker, copy, recording)
        )
        self._output, self._notes = recording.output, tuple(notes)

    def cancel(self) -> None:
        if self.state == "running":
            left = (
                "what there is of it can be played" if Path(self._output).exists() else "nothing of it was written yet"
            )
            logger.info("Stopped recording %s: %s", self._output, left)
        super().cancel()

    def _describe(self, error: Exception) -> str:
        return describe_error(f"{self._output} can't be recorded", error)

    def _take(self, last: Progress) -> None:
        logger.info("Recorded %s", self._output)
        for note in self._notes:
            logger.info("%s", note)
