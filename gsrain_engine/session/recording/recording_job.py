"""The job that records: save the document aside, record it in another process, say what came of it."""

import logging
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from gsrain_engine.render.recording import Recording
from gsrain_engine.scene.formats.known_files import KnownFiles
from gsrain_engine.scene.progress import Progress
from gsrain_engine.scene.scene import Scene

from ..jobs.copied_scene_job import CopiedSceneJob
from ..jobs.worker import Job
from ..log import told
from .recorded_project import record_in_worker

logger = logging.getLogger("gsrain")


class RecordingJob(CopiedSceneJob):
    """One recording. Its worker sees the numbers that the command line sees."""

    ends_with_scene = False  # it has a copy of the document that it began with

    def __init__(
        self,
        scene: Scene,
        recording: Recording,
        files: ThreadPoolExecutor,
        known: KnownFiles,
        notes: Sequence[str] = (),
    ) -> None:
        """Start; `notes` go into the log at the end."""
        title = f"Record {recording.path.name}"
        super().__init__(title, scene, known, files, lambda copy: Job(title, record_in_worker, copy, recording))
        self._output, self._notes = recording.output, tuple(notes)

    def cancel(self) -> None:
        if self.state == "running":
            left = (
                "what there is of it can be played" if Path(self._output).exists() else "nothing of it was written yet"
            )
            logger.info("Stopped recording %s: %s", self._output, left)
        super().cancel()

    def _said(self, error: Exception) -> str:
        return told(f"{self._output} can't be recorded", error)

    def _take(self, last: Progress) -> None:
        logger.info("Recorded %s", self._output)
        for note in self._notes:
            logger.info("%s", note)
