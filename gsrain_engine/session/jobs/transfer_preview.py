"""The job "Preview": one view as a transfer makes it, from where a person looks now."""

import logging
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from gsrain_engine.appearance.views.placed_camera import PlacedCamera
from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.progress import Progress

from ..rainy.previewed_view import PreviewedView
from .job_folder import JobFolder
from .scene_copy import write_copy
from .transfer_work import preview_view
from .worker import Job, JobState

if TYPE_CHECKING:
    from ..session import Session

logger = logging.getLogger("gsrain")

TITLE = "Preview"


class TransferPreview:
    """One view on its way, a `BackgroundJob`. Whoever has started it takes `result` when it is finished."""

    def __init__(self, wanted: PreviewedView, width_px: int, known: KnownFiles, files: ThreadPoolExecutor) -> None:
        """Start. `wanted` says what of; its pixels are those that stand in until there are others."""
        self.title = TITLE
        self.state: JobState = "running"
        self.progress = Progress(0.0, "Saving the scene for the worker")
        self.error: str | None = None
        self.details: str | None = None
        self.result: PreviewedView | None = None
        self._wanted = wanted
        placed = PlacedCamera(TITLE, wanted.camera, wanted.time_s).at_width(min(width_px, wanted.camera.width))
        self._placed = placed
        self._folder = JobFolder(files)
        self._copying: Future[Path] | None = self._folder.do(lambda folder: write_copy(wanted.scene, folder, known))
        self._worker: Job | None = None

    def poll(self, session: "Session") -> None:
        """Go on, without waiting."""
        if self.state != "running":
            return
        try:
            if self._copying is not None and self._copying.done():
                copy, self._copying = self._copying.result(), None
                recipe = self._wanted.recipe
                self._worker = Job(TITLE, preview_view, copy, recipe.method, recipe.settings, self._placed)
            if self._worker is not None:
                self._follow(self._worker)
        except Exception as error:  # whatever a disk or a worker can do: the window lives on
            self.error = str(error)
            self._end("failed")

    def cancel(self) -> None:
        """Stop, wherever it is."""
        if self.state == "running":
            self._end("cancelled")

    def _follow(self, worker: Job) -> None:
        worker.poll()
        self.progress = worker.progress
        if worker.state == "failed":
            self.error, self.details = worker.error, worker.details
            self._end("failed")
        elif worker.state == "finished":
            if worker.progress.preview is None:
                self.error = "the transfer has made no picture"
                self._end("failed")
                return
            self.result = replace(self._wanted, pixels=worker.progress.preview)
            self._end("finished")

    def _end(self, state: JobState) -> None:
        self.state = state
        if self._worker is not None:
            self._worker.cancel()
        if self._copying is not None:
            self._copying.cancel()
        self._folder.remove(self._worker)
        self._worker = None
