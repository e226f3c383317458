"""Records a saved scene with its own rain, weather and path, as `gsrain render PROJECT` does."""

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
    """The path that a person made for a scene, else the ego's drive, else a swing around it. World frame, metres."""
    return default_path(scene, width, height) if scene.path is None else scene.path.moved(scene.scene_to_world)


def record_project(folder: Path, recording: ExportSettings) -> Iterator[Progress]:
    """Record a scene folder.

    Raises:
        ValueError: For what contradicts itself, such as a camera that the scene does not have.
        OSError: When it can't be written; what had been written can be played.
    """
    yield Progress(0.0, "Reading the scene")
    scene = load_sorted_scene(str(folder))
    rainfall = RainSimulation.start(rain_of(scene) or RainSettings(), weather=keyframes_of(scene))
    path = own_path(scene, *(recording.size_px or DEFAULT_SIZE_PX))
    sequences = export_sequences(recording, scene, rainfall, path, in_scene_time=scene.path is not None)
    with open_renderer() as renderer:
        yield from export_frames(renderer, recording, sequences, frame_numbers(recording, sequences))


def record_in_worker(folder: Path, recording: ExportSettings) -> Iterator[Progress]:
    """Record as work of another process: told to end, it ends its videos first."""
    install_sigterm_handler()
    yield from record_project(folder, recording)


# § The job that records: save the document aside, record it in another process, say what came of it.

logger = logging.getLogger("gsrain")


class ExportJob(CopiedSceneJob):
    """One recording. Its worker sees the numbers that the command line sees."""

    ends_with_scene = False  # it has a copy of the document that it began with

    def __init__(
        self,
        scene: Scene,
        recording: ExportSettings,
        files: ThreadPoolExecutor,
        known: FileCache,
        notes: Sequence[str] = (),
    ) -> None:
        """Start; `notes` go into the log at the end."""
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
