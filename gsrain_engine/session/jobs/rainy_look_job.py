"""The job "Make it rainy (preview)" from click to swap: save, solve in another process, load, hand over."""

from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from gsrain_engine.reconstruct.recolored_file import read_recolored
from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from ..staged_scene import StagedScene
from .rainy_look import make_rainy, with_colors
from .scene_copy import SCENE, copy_scene, remove_copy
from .worker import Job, JobState

if TYPE_CHECKING:
    from ..session import Session

TITLE = "Make it rainy (preview)"
_COLORS = "colors.npz"


class RainyLookJob:
    """One run of the job, a `BackgroundJob`."""

    def __init__(self, scene: Scene, files: ThreadPoolExecutor, known: KnownFiles) -> None:
        """Start on a scene; `files` is where reading and writing happens."""
        self.title = TITLE
        self.scene = scene
        self.state: JobState = "running"
        self.progress = Progress(0.0, "Saving the scene for the worker")
        self.error: str | None = None
        self.details: str | None = None
        self._files = files
        self._saving: Future[Path] | None = files.submit(copy_scene, scene, known)
        self._folder: Path | None = None
        self._worker: Job | None = None
        self._loading: Future[Scene] | None = None

    def poll(self, session: "Session") -> None:
        """Go on to the next stage when the present one is through; never waits. The result is staged at the end."""
        if self.state != "running":
            return
        try:
            if self._saving is not None and self._saving.done():
                folder, self._saving = self._saving.result(), None
                self._folder = folder
                self._worker = Job(TITLE, make_rainy, folder / SCENE, folder / _COLORS)
            if self._worker is not None:
                self._follow(self._worker)
            if self._loading is not None and self._loading.done():
                if not session.is_opening:  # else it would take the place of the scene that comes
                    session.stage(StagedScene(self.title, self._loading.result()))
                self._end("finished")
        except Exception as error:  # whatever a disk or a worker can do: the window lives on
            self.error = str(error)
            self._end("failed")

    def cancel(self) -> None:
        """Stop, wherever it is; the scene stays as it was."""
        if self.state == "running":
            self._end("cancelled")

    def _follow(self, worker: Job) -> None:
        worker.poll()
        self.progress = worker.progress
        if worker.state == "failed":
            self.error, self.details = worker.error, worker.details
            self._end("failed")
        elif worker.state == "finished":
            self._worker = None
            self.progress = Progress(1.0, "Loading the result")
            self._loading = self._files.submit(self._load, worker)

    def _load(self, worker: Job) -> Scene:
        assert self._folder is not None
        worker.close()
        return with_colors(self.scene, read_recolored(self._folder / _COLORS))

    def _end(self, state: JobState) -> None:
        self.state = state
        if self._worker is not None:
            self._worker.cancel()
        if self._saving is not None:
            self._saving.cancel()
        # Ending a process and emptying a folder take their time: the window goes on meanwhile.
        self._files.submit(remove_copy, self._worker, self._saving, self._folder)
        self._worker = None
