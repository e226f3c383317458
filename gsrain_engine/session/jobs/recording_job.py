"""The job that records: save the document aside, record it in another process, say what came of it."""

import logging
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from gsrain_engine.render.recording import Recording
from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from ..log import told
from .job_folder import JobFolder
from .recorded_project import record_in_worker
from .scene_copy import write_copy
from .worker import Job, JobState

if TYPE_CHECKING:
    from ..session import Session

logger = logging.getLogger("gsrain")


class RecordingJob:
    """One recording, a `BackgroundJob`."""

    def __init__(
        self,
        scene: Scene,
        recording: Recording,
        files: ThreadPoolExecutor,
        known: KnownFiles,
        notes: Sequence[str] = (),
    ) -> None:
        """Start on a document as it goes into files; `files` is the thread where reading and writing happens.

        What `known` says to be in a file already is taken from there, so that the worker sees the numbers that the
        command line sees. `notes` go into the log at the end.
        """
        self.title = f"Record {recording.path.name}"
        self.state: JobState = "running"
        self.progress = Progress(0.0, "Saving the scene for the worker")
        self.error: str | None = None
        self.details: str | None = None
        self._recording, self._notes = recording, tuple(notes)
        self._folder = JobFolder(files)
        self._saving: Future[Path] | None = self._folder.do(lambda folder: write_copy(scene, folder, known))
        self._worker: Job | None = None

    def poll(self, session: "Session") -> None:
        """Go on to the next stage when the present one is through; never waits."""
        if self.state != "running":
            return
        try:
            if self._saving is not None and self._saving.done():
                saving, self._saving = self._saving, None
                self._worker = Job(self.title, record_in_worker, saving.result(), self._recording)
            if self._worker is not None:
                self._follow(self._worker)
        except Exception as error:  # whatever a disk can do: the window lives on
            self.error = told(f"{self._recording.output} can't be recorded", error)
            self._end("failed")

    def cancel(self) -> None:
        """Stop; what has been recorded so far can be played."""
        if self.state == "running":
            logger.info("Stopped recording %s: what there is of it can be played", self._recording.output)
            self._end("cancelled")

    def _follow(self, worker: Job) -> None:
        worker.poll()
        self.progress = worker.progress
        if worker.state == "failed":
            self.error, self.details = worker.error, worker.details
            self._end("failed")
        elif worker.state == "finished":
            logger.info("Recorded %s", self._recording.output)
            for note in self._notes:
                logger.info("%s", note)
            self._end("finished")

    def _end(self, state: JobState) -> None:
        self.state = state
        if self._worker is not None:
            self._worker.cancel()
        if self._saving is not None:
            self._saving.cancel()
        self._folder.remove(self._worker)
        self._worker = self._saving = None
