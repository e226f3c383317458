"""A job whose worker gets a copy of the document: save it aside, work in another process, take what came of it."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from gsrain_engine.scene.errors import sentence_of
from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from ..document.viewed_document import ViewedDocument
from .job_folder import JobFolder
from .scene_copy import write_copy
from .worker import Job, JobState


class CopiedSceneJob:
    """One run, a `BackgroundJob`. A kind of job says what comes of it in `_take`."""

    ends_with_scene = True

    def __init__(
        self, title: str, scene: Scene, known: KnownFiles, files: ThreadPoolExecutor, start: Callable[[Path], Job]
    ) -> None:
        """Start on a document as it goes into files; `files` is the thread where reading and writing happens.

        What `known` says to be in a file already is taken from there. `start` begins the work on the copy's folder.
        """
        self.title = title
        self.state: JobState = "running"
        self.progress = Progress(0.0, "Saving the scene for the worker")
        self.error: str | None = None
        self.details: str | None = None
        self._start = start
        self._folder = JobFolder(files)
        self._copying: Future[Path] | None = self._folder.do(lambda folder: write_copy(scene, folder, known))
        self._worker: Job | None = None

    def poll(self, session: ViewedDocument) -> None:
        """Go on to the next stage when the present one is through; never waits."""
        if self.state != "running":
            return
        try:
            if self._copying is not None and self._copying.done():
                copying, self._copying = self._copying, None
                self._worker = self._start(copying.result())
            if self._worker is not None:
                self._follow(self._worker)
        except Exception as error:  # whatever a disk or a worker can do: the window lives on
            self.error = self._said(error)
            self._end("failed")

    def cancel(self) -> None:
        if self.state == "running":
            self._end("cancelled")

    def _take(self, last: Progress) -> None:
        """Take what the worker has ended with; raises what stands in the way of that."""
        raise NotImplementedError

    def _said(self, error: Exception) -> str:
        return sentence_of(error)

    def _follow(self, worker: Job) -> None:
        worker.poll()
        self.progress = worker.progress
        if worker.state == "failed":
            self.error, self.details = worker.error, worker.details
            self._end("failed")
        elif worker.state == "finished":
            self._take(worker.progress)
            self._end("finished")

    def _end(self, state: JobState) -> None:
        self.state = state
        if self._worker is not None:
            self._worker.cancel()
        if self._copying is not None:
            self._copying.cancel()
        self._folder.remove(self._worker)
        self._worker = self._copying = None
